"""Vehicle files: found by name or path, read strictly, written canonically."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from trimtab.host.vehicle.model import Vehicle, hover_problem
from trimtab.host.vehicle.parameters import parameter_problems
from trimtab.host.vehicle.strict_toml import ConfigurationError, Strict, parse_toml, validate


def parse_vehicle(text: str, source: str) -> Vehicle:
    """Return the vehicle in a TOML text; `source` names it in errors.

    Raises ConfigurationError with every problem.
    """
    data = parse_toml(text, source)
    try:
        vehicle, told = validate(data, source, Vehicle), ()
    except ConfigurationError as error:
        vehicle, told = None, error.problems
    # What the board refuses and what lies between keys is told beside keys that are wrong by themselves.
    wrong = {line.removeprefix(f"{source}: ").split(": ")[0] for line in told}
    more = [
        f"{source}: {key}: {what}"
        for key, what in parameter_problems(data)
        if wrong.isdisjoint((key, key.rpartition("[")[0]))
    ]
    if hover := hover_problem(data):
        more.append(f"{source}: {hover}")
    if vehicle is None or more:
        raise ConfigurationError(list(dict.fromkeys([*told, *more])))
    return vehicle


def load_vehicle(name_or_path: str | Path, workspace: Path | None = None) -> Vehicle:
    """Return the vehicle of a path, or of a name: looked up in `workspace`/vehicles, then among the shipped
    ones.

    Raises ConfigurationError (exit code 2) where no such file is, or it has problems.
    """
    path = find_file(name_or_path, "vehicles", workspace, what="vehicle")
    return parse_vehicle(read_text(path), shown(path))


def list_vehicles(workspace: Path | None = None) -> dict[str, Path]:
    """Name to file of every vehicle: the shipped ones, over them those of `workspace`."""
    return list_files("vehicles", workspace)


def list_files(folder: str, workspace: Path | None) -> dict[str, Path]:
    """Name to file of every TOML in the shipped `folder`, over them those of `workspace`; sorted by name."""
    found: dict[str, Path] = {}
    places = [Path(str(files("trimtab.host") / folder))]
    if workspace is not None:
        places.append(Path(workspace) / folder)
    for place in places:
        found.update({path.stem: path for path in sorted(place.glob("*.toml"))})
    return dict(sorted(found.items()))


def find_file(name_or_path: str | Path, folder: str, workspace: Path | None, *, what: str) -> Path:
    """Return the file meant by a name or a path. Raises ConfigurationError naming the known ones."""
    text = str(name_or_path)
    if text.endswith(".toml") or "/" in text or isinstance(name_or_path, Path):
        path = Path(text)
        if not path.is_file():
            raise ConfigurationError([f"{text}: no such {what} file, check the path"])
        return path
    known = list_files(folder, workspace)
    if text not in known:
        raise ConfigurationError(
            [f"{text}: no such {what}, known: {', '.join(known) or 'none'}; or give a path to a .toml"]
        )
    return known[text]


def read_text(path: Path) -> str:
    """Return a file's text. Raises ConfigurationError where it cannot be read or is not UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            [f"{shown(path)}: not UTF-8 text at byte {error.start}, save it as UTF-8"]
        ) from None
    except OSError as error:
        raise ConfigurationError(
            [f"{shown(path)}: cannot be read ({error.strerror}), check the file"]
        ) from None


def write_toml(model: Strict) -> str:
    """Canonical TOML of a strict model: fields in declared order, scalars first, `None` left out."""
    lines: list[str] = []
    _write_table(model, "", lines)
    return "\n".join(lines) + "\n"


def _write_table(table: Strict | Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    """Append a table's own keys, then its sub-tables under their full names."""
    if isinstance(table, Strict):
        items = [(name, getattr(table, name)) for name in type(table).model_fields]
    else:
        items = sorted(table.items())
    nested = []
    for key, value in items:
        if value is None:
            continue
        if _is_table(value) or (isinstance(value, tuple) and value and _is_table(value[0])):
            nested.append((key, value))
        else:
            lines.append(f"{_key(key)} = {_value(value)}")
    for key, value in nested:
        name = f"{prefix}{_key(key)}"
        for entry in value if isinstance(value, tuple) else (value,):
            lines.extend(("", f"[[{name}]]" if isinstance(value, tuple) else f"[{name}]"))
            _write_table(entry, f"{name}.", lines)


def _is_table(value: Any) -> bool:
    return isinstance(value, Strict | Mapping)


def _key(key: str) -> str:
    """Return a bare key where TOML allows it, else a quoted one."""
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else f'"{key}"'


def _value(value: Any) -> str:
    """Return a scalar or a list of scalars as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
    return "[" + ", ".join(_value(item) for item in value) + "]"


def shown(path: Path) -> str:
    """Return a path as messages show it: relative where it lies below the current folder."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)
