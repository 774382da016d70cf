"""The import profiles by name."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.imports.recording import Recording

PROFILES = ("nanobench", "crazyflie-usd", "csv")


def read(profile: str, path: Path, columns: Path | None = None) -> Recording:
    """Return the recording at `path`, read with a profile; `columns` is the column map, for csv only.

    Raises ImportFormatError (exit code 5) for the log, ConfigurationError (2) for the map, and ValueError
    for an unknown profile, or if csv has no map or another profile has one.
    """
    if (profile == "csv") != (columns is not None):
        raise ValueError(f"the csv profile needs a column map and no other profile takes one, got {profile}")
    if columns is not None:
        from trimtab.host.imports.columns import read as read_columns

        return read_columns(path, columns)
    if profile == "nanobench":
        from trimtab.host.imports.nanobench import read as read_nanobench

        return read_nanobench(path)
    if profile == "crazyflie-usd":
        from trimtab.host.imports.crazyflie_usd import read as read_usd

        return read_usd(path)
    raise ValueError(f"profile {profile!r} is not one of {', '.join(PROFILES)}")
