"""Support for effect files of version 0.1, which import `host.effects`, for one more release."""

from __future__ import annotations

import ast
import importlib
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_FLAT = frozenset({"host", "protocol", "firmware_model", "sitl"})
_PACKAGE = "trimtab"


def flat_imports(source: bytes) -> list[str]:
    """Return the modules, sorted, that a source text imports by their names of version 0.1."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return []  # executing the file reports the error
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            names.add(node.module)
    return sorted(name for name in names if name.partition(".")[0] in _FLAT)


@contextmanager
def accepted(label: str, source: bytes) -> Iterator[None]:
    """Resolve imports by names of version 0.1 to `trimtab.*` inside the context, and warn about them.

    label: name of the file in the warning. source: its content.
    """
    flat = flat_imports(source)
    if not flat:
        yield
        return
    warnings.warn(
        f"{label}: imports {', '.join(flat)}; write {', '.join(f'{_PACKAGE}.{name}' for name in flat)}. "
        "The old names work only in this release",
        FutureWarning,
        stacklevel=2,
    )
    hidden = _take_flat_modules()
    finder = _Finder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        _take_flat_modules()
        sys.modules.update(hidden)


def _take_flat_modules() -> dict[str, ModuleType]:
    """Remove and return the loaded modules with names of version 0.1: modules of the user, or aliases."""
    names = [name for name in sys.modules if name.partition(".")[0] in _FLAT]
    return {name: sys.modules.pop(name) for name in names}


class _Finder(MetaPathFinder):
    """Finder of `host.effects` and other names of version 0.1 as `trimtab.host.effects` etc."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname.partition(".")[0] not in _FLAT:
            return None
        return ModuleSpec(fullname, _Alias())


class _Alias(Loader):
    """Loader of a module under its name of version 0.1: the same module, not a second copy."""

    def exec_module(self, module: ModuleType) -> None:
        sys.modules[module.__name__] = importlib.import_module(f"{_PACKAGE}.{module.__name__}")
