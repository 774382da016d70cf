"""A workspace: a folder with the user's own vehicles/, routes/ and effects/ beside the shipped ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.base.errors import UsageError

if TYPE_CHECKING:
    from trimtab.host.route import Route
    from trimtab.host.vehicle import Vehicle


FOLDERS = ("vehicles", "routes", "effects")
"""Where a workspace keeps its own files."""


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """The folder that names are looked up in, before the shipped files."""

    root: Path

    def vehicle(self, name_or_path: str | Path) -> Vehicle:
        """Return the vehicle of a name or path. Raises ConfigurationError."""
        from trimtab.host.vehicle import load_vehicle

        return load_vehicle(name_or_path, self.root)

    def route(self, name_or_path: str | Path, vehicle: Vehicle | None = None) -> Route:
        """Return the route of a name (`random:SEED` too) or path, with `vehicle` for more complete errors.

        Raises ConfigurationError.
        """
        from trimtab.host.route import load_route

        return load_route(name_or_path, self.root, vehicle)

    def effect_files(self) -> dict[str, Path]:
        """Name (`slow-leak` for slow_leak.py) to file of the user's own candidate effects."""
        found = sorted((self.root / "effects").glob("*.py"))
        return {path.stem.replace("_", "-"): path for path in found if not path.stem.startswith("_")}


def open_workspace(folder: str | Path | None = None) -> Workspace:
    """Return the workspace of `folder`, the current one where None. Raises UsageError where there is none.

    None of its folders need be there; one of their names that is a file's is refused too.
    """
    root = Path.cwd() if folder is None else Path(folder)
    if not root.is_dir():
        raise UsageError(f"{folder}: no such folder, give --workspace one that exists")
    for name in FOLDERS:
        if (root / name).exists() and not (root / name).is_dir():
            raise UsageError(f"{root / name}: is a file where a workspace has a folder, rename it")
    return Workspace(root=root)
