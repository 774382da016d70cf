"""Access to the host's command line for studies: words in, exit code and JSON object out."""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from trimtab.sitl.studies.files import StudyError

COMMAND = "trimtab"

_KEPT = ("PATH", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "TRIMTAB_ENGINE")
"""Variables that a process on its own inherits."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Result of a run: exit code, JSON object (empty if there was none), and text on stderr.

    `cpu_s` is the processor time of a run in a separate process.
    """

    code: int
    data: dict[str, Any]
    errors: str
    cpu_s: float | None = None


def run_apart(words: Sequence[str], folder: Path, *, alone: bool = False) -> Answer:
    """Run `trimtab WORDS --json` in a separate process in `folder`, and return the answer.

    alone: whether the process gets only `bare_environment`, instead of the environment of this process.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "trimtab.host.cli", *words, "--json"],
        cwd=folder,
        env=bare_environment(folder) if alone else None,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Answer(code=done.returncode, data=_last(done.stdout), errors=done.stderr, cpu_s=cpu_s)


def bare_environment(folder: Path) -> dict[str, str]:
    """Return the environment of a process that must know nothing but `folder`, its home.

    It holds where programs, the package and compiled models are, and the engine. No path of a study is in it.
    """
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    packages = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return {
        **kept,
        "PYTHONPATH": os.pathsep.join(str(Path(path).absolute()) for path in packages if path),
        "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache"),
        "HOME": str(folder),
        "TMPDIR": str(folder),
    }


def run_inside(words: Sequence[str]) -> Answer:
    """Run `trimtab WORDS --json` in this process, for runs shorter than the start of Python."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = _command()([*words, "--json"])
    return Answer(code=code, data=_last(out.getvalue()), errors=errors.getvalue())


def _command() -> Any:
    """Return the function of the installed command."""
    points = entry_points(group="console_scripts", name=COMMAND)
    if not points:
        raise StudyError(f"the command {COMMAND} is not installed; install the complete trimtab")
    return next(iter(points)).load()


def _last(text: str) -> dict[str, Any]:
    lines = text.splitlines()
    if not lines or not lines[-1].startswith("{"):
        return {}
    return json.loads(lines[-1])
