"""The host's command line as a study uses it: words in, exit code and JSON object out."""

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


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a run said: its exit code, its JSON object (empty where there was none), what went to stderr.

    `cpu_s` is the processor time of a run in a process of its own.
    """

    code: int
    data: dict[str, Any]
    errors: str
    cpu_s: float | None = None


def run_apart(words: Sequence[str], folder: Path) -> Answer:
    """Return the answer of `trimtab WORDS --json` in a process of its own, with `folder` as current one."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "trimtab.host.cli", *words, "--json"],
        cwd=folder,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Answer(code=done.returncode, data=_last(done.stdout), errors=done.stderr, cpu_s=cpu_s)


def run_inside(words: Sequence[str]) -> Answer:
    """Return the answer of `trimtab WORDS --json` in this process, for runs shorter than a start of
    Python.
    """
    out, errors, kept = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = [COMMAND, *words, "--json"]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            code = _command()(sys.argv[1:])
    finally:
        sys.argv = kept
    return Answer(code=code, data=_last(out.getvalue()), errors=errors.getvalue())


def _command() -> Any:
    """Return the function behind the installed command."""
    found = entry_points(group="console_scripts", name=COMMAND)
    if not found:
        raise StudyError(f"the command {COMMAND} is not installed, install trimtab as a whole")
    return next(iter(found)).load()


def _last(text: str) -> dict[str, Any]:
    lines = text.splitlines()
    if not lines or not lines[-1].startswith("{"):
        return {}
    return json.loads(lines[-1])
