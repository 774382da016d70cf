"""Libraries that only some formats of logs and plans need."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module, metadata
from importlib.util import find_spec
from types import ModuleType

from trimtab.host.base.errors import UsageError

_EXTRA = re.compile(r"\s*extra == ['\"]([\w-]+)['\"]\s*")


def requirements(extra: str | None) -> list[str]:
    """Return what an extra of Trimtab needs, such as "numpy>=2"; for None what is always needed."""
    split = (requirement.partition(";") for requirement in metadata.requires("trimtab") or ())
    named = [(text.strip(), _EXTRA.fullmatch(condition)) for text, _, condition in split]
    return [text for text, match in named if (None if match is None else match[1]) == extra]


def install_command(extra: str) -> str:
    """Return the command that installs an extra into this Python, for a POSIX shell.

    It names the packages: Trimtab itself may come from a folder or a file.
    """
    if find_spec("pip") is not None:
        command = [sys.executable, "-m", "pip", "install"]
    elif shutil.which("uv") is not None:
        command = ["uv", "pip", "install", "--python", sys.executable]
    else:
        command = ["pip", "--python", sys.executable, "install"]
    return shlex.join([*command, *requirements(extra)])


def optional(name: str, extra: str) -> ModuleType:
    """Return a module of an optional library. Raises UsageError with the extra that installs it."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise UsageError(f"{name} is not installed; run {install_command(extra)}") from None


@contextmanager
def quiet() -> Iterator[None]:
    """Drop what a library prints about a damaged file. Its code in C writes to the descriptor itself."""
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        standard_error = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            with redirect_stdout(nowhere), redirect_stderr(nowhere):
                yield
        finally:
            os.dup2(standard_error, 2)
            os.close(standard_error)
