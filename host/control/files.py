"""Access to controller files: find by name or path, read strictly."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.control.settings import ControllerSettings, DfbcSettings, MpcSettings
from trimtab.host.vehicle.files import find_file, list_files, read_text, shown
from trimtab.host.vehicle.strict_toml import ConfigurationError, parse_toml, validate

_KINDS: dict[str, type[DfbcSettings] | type[MpcSettings]] = {"dfbc": DfbcSettings, "mpc": MpcSettings}


def parse_controller(text: str, source: str) -> ControllerSettings:
    """Return the settings in a TOML text; `source` names it in errors.

    Raises ConfigurationError with every problem.
    """
    data = parse_toml(text, source)
    kind = data.get("kind")
    model = _KINDS.get(kind) if isinstance(kind, str) else None
    if model is None:
        given = "missing" if kind is None else f"{kind!r} is not possible"
        raise ConfigurationError([f"{source}: kind: {given}; choose 'dfbc' or 'mpc'"])
    return validate(data, source, model)


def load_controller(name_or_path: str | Path, workspace: Path | None = None) -> ControllerSettings:
    """Return the settings of a path or of a name, from `workspace`/controllers or from the shipped files.

    Raises ConfigurationError (exit code 2) if there is no such file or it has problems.
    """
    path = find_file(name_or_path, "controllers", workspace, what="controller")
    return parse_controller(read_text(path), shown(path))


def list_controllers(workspace: Path | None = None) -> dict[str, Path]:
    """Return the files of all controllers by name. Those of `workspace` override the shipped ones."""
    return list_files("controllers", workspace)
