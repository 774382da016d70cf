"""The formats of foreign logs by name, each read by the module of its name.

A format's module has three functions. `recognises(path, head)` returns whether the file, with its first
`HEAD_BYTES`, has the format. `contents(path)` returns its topics and rates, also of a file without enough for
an import. `read(path)` returns the flight. They raise ImportFormatError for a file that they cannot read.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Literal, Protocol, cast, get_args

from trimtab.host.imports.contents import Contents
from trimtab.host.imports.recording import ImportFormatError, Recording, reading

FormatName = Literal["ulog", "dataflash", "rosbag", "betaflight", "crazyflie-usd", "nanobench", "csv"]
FORMATS: tuple[FormatName, ...] = get_args(FormatName)
"""Names in the order in which they are tried on a file; csv takes any table, so it is last."""

LOGGING_PROFILES: dict[FormatName, str] = {
    "ulog": "docs/logging/px4.params",
    "dataflash": "docs/logging/ardupilot.param",
    "crazyflie-usd": "docs/logging/crazyflie-usd.txt",
}
"""Settings with which a vehicle logs what tracing needs, by format."""

HEAD_BYTES = 4096


class FormatModule(Protocol):
    """What the module of a format holds."""

    def recognises(self, path: Path, head: bytes) -> bool: ...
    def contents(self, path: Path) -> Contents: ...
    def read(self, path: Path) -> Recording: ...


def module(name: FormatName) -> FormatModule:
    """Return the module of a format."""
    return cast(FormatModule, import_module(f"{__name__}.{name.replace('-', '_')}"))


def recognise(path: Path) -> FormatName:
    """Return the format of a file or folder. Raises ImportFormatError if it has none of them."""
    with reading(path):
        head = b"" if path.is_dir() else _head(path)
    for name in FORMATS:
        if module(name).recognises(path, head):
            return name
    raise ImportFormatError(f"{path.name}: none of the formats {', '.join(FORMATS)}; convert it to CSV")


def read(name: FormatName, path: Path, columns: Path | None = None, topics: Path | None = None) -> Recording:
    """Return the recording at `path`; `columns` is csv's column map, `topics` a topic map for a rosbag.

    Raises ImportFormatError (exit code 5) for the log, ConfigurationError (2) for a map, and ValueError if
    csv has no column map or another format has a map that is not its own.
    """
    if (name == "csv") != (columns is not None):
        raise ValueError(f"csv needs a column map and no other format takes one, got {name}")
    if topics is not None and name != "rosbag":
        raise ValueError(f"only a rosbag takes a topic map, got {name}")
    if columns is not None:
        from trimtab.host.imports.formats.csv import read as read_csv

        return read_csv(path, columns)
    if topics is not None:
        from trimtab.host.imports.formats.rosbag import read as read_bag
        from trimtab.host.imports.formats.rosbag import read_map

        return read_bag(path, read_map(topics))
    return module(name).read(path)


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(HEAD_BYTES)
