"""Access to vehicle files: find by name or path, read strictly, write canonically."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from trimtab.host.base import bounds
from trimtab.host.vehicle.model import Vehicle, hover_problem
from trimtab.host.vehicle.parameters import parameter_problems
from trimtab.host.vehicle.strict_toml import ConfigurationError, parse_toml, validate


def parse_vehicle(text: str, source: str) -> Vehicle:
    """Return the vehicle in a TOML text; `source` names it in errors.

    Raises ConfigurationError with every problem.
    """
    data = parse_toml(text, source)
    try:
        vehicle, problems = validate(data, source, Vehicle), ()
    except ConfigurationError as error:
        vehicle, problems = None, error.problems
    # Also report parameters that the firmware refuses and relations between keys, for keys that are valid.
    invalid = {line.removeprefix(f"{source}: ").split(": ")[0] for line in problems}
    more = [
        f"{source}: {key}: {problem}"
        for key, problem in parameter_problems(data)
        if invalid.isdisjoint((key, key.rpartition("[")[0]))
    ]
    if hover := hover_problem(data):
        more.append(f"{source}: {hover}")
    if vehicle is None or more:
        raise ConfigurationError(list(dict.fromkeys([*problems, *more])))
    return vehicle


def load_vehicle(name_or_path: str | Path, workspace: Path | None = None) -> Vehicle:
    """Return the vehicle of a path or of a name, from `workspace`/vehicles or from the shipped files.

    Raises ConfigurationError (exit code 2) if there is no such file or it has problems.
    """
    path = find_file(name_or_path, "vehicles", workspace, what="vehicle")
    return parse_vehicle(read_text(path), shown(path))


def list_vehicles(workspace: Path | None = None) -> dict[str, Path]:
    """Return the files of all vehicles by name. Those of `workspace` override the shipped ones."""
    return list_files("vehicles", workspace)


def list_files(folder: str, workspace: Path | None) -> dict[str, Path]:
    """Return the TOML files of `folder` by sorted name. Those of `workspace` override the shipped ones."""
    by_name: dict[str, Path] = {}
    roots = [Path(str(files("trimtab.host") / folder))]
    if workspace is not None:
        roots.append(Path(workspace) / folder)
    for root in roots:
        by_name.update({path.stem: path for path in sorted(root.glob("*.toml"))})
    return dict(sorted(by_name.items()))


def find_file(name_or_path: str | Path, folder: str, workspace: Path | None, *, what: str) -> Path:
    """Return the file of a name or a path. Raises ConfigurationError with the known names."""
    text = str(name_or_path)
    if text.endswith(".toml") or "/" in text or isinstance(name_or_path, Path):
        path = Path(text)
        if not path.is_file():
            raise ConfigurationError([f"{text}: no such {what} file; check the path"])
        return path
    known = list_files(folder, workspace)
    if text not in known:
        raise ConfigurationError(
            [f"{text}: no such {what} (known: {', '.join(known) or 'none'}); give one or a path to a .toml"]
        )
    return known[text]


def read_text(path: Path) -> str:
    """Return a file's text. Raises ConfigurationError if it cannot be read or is not UTF-8."""
    try:
        return bounds.read_text(path, bounds.TOML_BYTES)
    except bounds.TooLarge as error:
        raise ConfigurationError([f"{shown(path)}: {error}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            [f"{shown(path)}: not UTF-8 text at byte {error.start}; save it as UTF-8"]
        ) from None
    except OSError as error:
        raise ConfigurationError(
            [f"{shown(path)}: cannot be read ({error.strerror}); check the file"]
        ) from None


def shown(path: Path) -> str:
    """Return a path for messages: relative if it lies below the current folder."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)
