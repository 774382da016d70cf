"""A workspace: a folder with the user's own files beside the shipped ones, by kind in subfolders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from trimtab.host.base.artefacts import write_atomic
from trimtab.host.base.errors import UsageError

if TYPE_CHECKING:
    from trimtab.host.control.settings import ControllerSettings
    from trimtab.host.effects import Effect
    from trimtab.host.route import Route
    from trimtab.host.vehicle import Vehicle


DEFAULT_VEHICLE = "research"
"""Vehicle where none is given."""
FOLDERS = ("vehicles", "routes", "effects", "controllers")
"""Folders of a workspace."""


@dataclass(frozen=True, kw_only=True)
class Workspace:
    """A folder in which names are looked up before the shipped files.

    trusted: whether its code may run although others can change it.
    """

    root: Path
    trusted: bool = False

    def effects(self) -> dict[str, Effect]:
        """Return the candidate effects by name: the shipped ones, then those of the workspace.

        Raises EffectError, and UntrustedError if others can change a file of the workspace.
        """
        from trimtab.host.effects import load_effects

        return load_effects(self.root, trusted=self.trusted)

    def vehicle(self, name_or_path: str | Path) -> Vehicle:
        """Return the vehicle of a name or path. Raises ConfigurationError.

        The tolerances of a file that is not shipped must be of effects, shipped or of the workspace.
        """
        from trimtab.host.vehicle import list_vehicles, load_vehicle
        from trimtab.host.vehicle.files import find_file, shown

        path = find_file(name_or_path, "vehicles", self.root, what="vehicle")
        vehicle = load_vehicle(path)
        if list_vehicles().get(path.stem) != path:
            self._check_tolerances(vehicle, shown(path))
        return vehicle

    def _check_tolerances(self, vehicle: Vehicle, source: str) -> None:
        """Raise ConfigurationError for tolerances that no effect has. `source` names the vehicle's file."""
        import difflib

        from trimtab.host.effects import load_effects
        from trimtab.host.vehicle import ConfigurationError

        known: set[str] = set()
        for load in (load_effects, self.effects):  # a faulty effect of the user's matters only if needed
            for name, effect in load().items():
                known |= {name, *(f"{name}.{key}" for key in effect.keys)}
            unknown = [key for key in vehicle.tolerances if key not in known]
            if not unknown:
                return
        problems = []
        for key in unknown:
            near = difflib.get_close_matches(key, sorted(known), n=1)
            remedy = f"did you mean {near[0]}?" if near else "remove it or give its --workspace"
            problems.append(f"{source}: tolerances.{key}: no effect has this parameter; {remedy}")
        raise ConfigurationError(problems)

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


def open_workspace(folder: str | Path | Workspace | None = None, *, trusted: bool = False) -> Workspace:
    """Return the workspace in a folder.

    Parameters
    ----------
    folder
        Folder. Its subfolders need not exist. A workspace is returned as it is. Default: the current folder.
    trusted
        Run the code in the workspace, its effects, even if others can change it.

    Returns
    -------
    Workspace
        What the functions take as `workspace`.

    Raises
    ------
    UsageError
        If the folder does not exist, or if a file has the name of a subfolder.
    """
    if isinstance(folder, Workspace):
        return folder
    root = Path.cwd() if folder is None else Path(folder)
    if not root.is_dir():
        raise UsageError(f"{folder}: no such folder; give --workspace an existing one")
    for name in FOLDERS:
        if (root / name).exists() and not (root / name).is_dir():
            raise UsageError(f"{root / name}: is a file where a workspace has a folder; rename it")
    return Workspace(root=root, trusted=trusted)


_ROUTE = """\
# An example: a square, back to where it began. Positions are north, east, down in metres; up is negative.
name = "square"
total_time_s = 8.0
waypoints_m = [[0, 0, -1.2], [1.5, 0, -1.2], [1.5, 1.5, -1.2], [0, 1.5, -1.2], [0, 0, -1.2]]
"""
_README = """\
# Workspace of Trimtab

- `vehicles/`: vehicle files. `trimtab vehicle new NAME ...` writes one here.
- `routes/`: route files. `trimtab plan square` plans the example.
- `effects/`: candidate effects of your own, one Python file each.
- `controllers/`: controller files.

Run `trimtab` in this folder, or with `--workspace`. `trimtab lineage FILE` tells what a file came from.
"""


def make_workspace(root: Path) -> list[Path]:
    """Make the folders of a workspace, with a route as an example, and return what was made.

    What exists stays as it is. Raises UsageError if `root` is a file or cannot be written to.
    """
    made: list[Path] = []
    try:
        for folder in (root, *(root / name for name in FOLDERS)):
            if not folder.is_dir():
                folder.mkdir(parents=True)
                made.append(folder)
        for path, text in ((root / "README.md", _README), (root / "routes" / "square.toml", _ROUTE)):
            if not path.exists():
                write_atomic(path, text)
                made.append(path)
    except OSError as error:
        place = error.filename or root
        raise UsageError(f"{place}: cannot be made ({error.strerror}); choose another folder") from error
    return made
