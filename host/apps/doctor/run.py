"""All checks, in order. Each imports its packages when it runs, since one of them may be missing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from trimtab.host.apps.doctor.check import Check


def all_checks(workspace: Path | None, *, trusted: bool = False) -> list[Check]:
    """Return the checks of Python, packages, compiled code, files and ports.

    workspace: its folder; None for the current one. trusted: whether its code may run although others can
    change it.
    """
    return [
        *_done("python", _python),
        *_done("compiled code", _compiled),
        *_done("workspace", lambda: _workspace(workspace, trusted)),
        *_done("ports", _ports),
    ]


def _done(name: str, run: Callable[[], Iterable[Check]]) -> list[Check]:
    """Return the checks that `run` makes; one with a problem if it needs a package that is missing."""
    try:
        return list(run())
    except ImportError as error:
        remedy = "install Trimtab again with its dependencies"
        return [Check(name=name, status="problem", text=f"cannot be checked: {error}", remedy=remedy)]


def _python() -> Iterable[Check]:
    from trimtab.host.apps.doctor import packages

    return [packages.python(), packages.required(), *packages.extras()]


def _compiled() -> Iterable[Check]:
    from trimtab.host.apps.doctor import machine

    return [machine.compiled_code(), machine.cache(), machine.temporary_files()]


def _workspace(folder: Path | None, trusted: bool) -> Iterable[Check]:
    from trimtab.host.apps.doctor import files

    return files.workspace(folder, trusted=trusted)


def _ports() -> Iterable[Check]:
    from trimtab.host.apps.doctor import ports

    return [*ports.serial_ports(), ports.pseudo_terminal(), ports.datagrams()]
