"""Libraries that only some formats of logs and plans need."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from types import ModuleType

from trimtab.host.base.errors import UsageError


def optional(name: str, extra: str) -> ModuleType:
    """Return a module of an optional library. Raises UsageError with the extra that installs it."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise UsageError(f"{name} is not installed; run pip install 'trimtab[{extra}]'") from None


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
