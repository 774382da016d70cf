"""Libraries that only some formats of logs and plans need."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from trimtab.host.base.errors import UsageError


def optional(name: str, extra: str) -> ModuleType:
    """Return a module of an optional library. Raises UsageError with the extra that installs it."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise UsageError(f"{name} is not installed; run pip install 'trimtab[{extra}]'") from None
