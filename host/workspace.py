"""A workspace: a folder with the user's own files beside the shipped ones, by kind in subfolders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.base.errors import UsageError

if TYPE_CHECKING:
    from trimtab.host.control.settings import ControllerSettings
    from trimtab.host.route import Route
    from trimtab.host.vehicle import Vehicle


FOLDERS = ("vehicles", "routes", "effects", "controllers")
"""Folders of a workspace."""


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """A folder in which names are looked up before the shipped files."""

    root: Path

    def vehicle(self, name_or_path: str | Path) -> Vehicle:
        """Return the vehicle of a name or path. Raises ConfigurationError."""
        from trimtab.host.vehicle import load_vehicle

        return load_vehicle(name_or_path, self.root)

    def route(self, name_or_path: str | Path, vehicle: Vehicle | None = None) -> Route:
        """Return the route of a name (also `random:SEED`) or path; `vehicle` makes errors more complete.

        Raises ConfigurationError.
        """
        from trimtab.host.route import load_route

        return load_route(name_or_path, self.root, vehicle)

    def controller(self, name_or_path: str | Path) -> ControllerSettings:
        """Return the settings of a controller by name or path. Raises ConfigurationError."""
        from trimtab.host.control.files import load_controller

        return load_controller(name_or_path, self.root)

    def effect_files(self) -> dict[str, Path]:
        """Return the files of the user's candidate effects by name (`slow-leak` for slow_leak.py)."""
        files = sorted((self.root / "effects").glob("*.py"))
        return {path.stem.replace("_", "-"): path for path in files if not path.stem.startswith("_")}


def open_workspace(folder: str | Path | None = None) -> Workspace:
    """Return the workspace in `folder` or, for None, in the current folder.

    Its subfolders need not exist. Raises UsageError if `folder` does not exist, or if a file has the name of
    a subfolder.
    """
    root = Path.cwd() if folder is None else Path(folder)
    if not root.is_dir():
        raise UsageError(f"{folder}: no such folder; give --workspace an existing one")
    for name in FOLDERS:
        if (root / name).exists() and not (root / name).is_dir():
            raise UsageError(f"{root / name}: is a file where a workspace has a folder; rename it")
    return Workspace(root=root)
