"""Convert a foreign flight log to a Trimtab log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trimtab.host.api.load import vehicle_of
from trimtab.host.base.card import card, table
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parallel import one_thread_of_algebra
from trimtab.host.workspace import Workspace, open_workspace

if TYPE_CHECKING:
    from trimtab.host.base.parts import PartFile
    from trimtab.host.effects import Effect
    from trimtab.host.imports.contents import Topic
    from trimtab.host.imports.formats import FormatName
    from trimtab.host.imports.recording import Cut, Recording
    from trimtab.host.log import Flight, Rebuilt
    from trimtab.host.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class ForeignLog:
    """A foreign file, its format, and the map that belongs to it.

    recognised: whether the format was recognised, and not given.
    """

    format: FormatName
    path: Path
    recognised: bool
    columns: Path | None
    topics: Path | None

    @classmethod
    def of(
        cls,
        path: str | Path,
        format: str | None = None,
        *,
        columns: str | Path | None = None,
        topics: str | Path | None = None,
    ) -> ForeignLog:
        """Return the file with its format. Raises UsageError, ImportFormatError if it is not recognised."""
        from trimtab.host.imports.formats import FORMATS, recognise

        path = Path(path)
        named: dict[str, FormatName] = {known: known for known in FORMATS}
        if format is not None and format not in named:
            raise UsageError(f"{format}: not a format; give one of {', '.join(FORMATS)}")
        name = recognise(path) if format is None else named[format]
        if columns is not None and name != "csv":
            raise UsageError(f"--columns is for csv, and {path.name} is {name}")
        if topics is not None and name != "rosbag":
            raise UsageError(f"--topics is for rosbag, and {path.name} is {name}")
        return cls(
            format=name,
            path=path,
            recognised=format is None,
            columns=None if columns is None else Path(columns),
            topics=None if topics is None else Path(topics),
        )

    def read(self) -> Recording:
        """Return the recording. Raises ImportFormatError for the file, ConfigurationError for the map."""
        from trimtab.host.imports.formats import read

        return read(self.format, self.path, self.columns, self.topics)


@dataclass(frozen=True, kw_only=True)
class Visible:
    """What a recording does not determine, which effects it cannot show, and what was left out of it.

    invisible_effects: the reason by name. flights_us: begin and end of each time in the air. rebuilt: part of
    the attitude that was not logged. cut: parts of the flights that are not traced.
    """

    unknown: tuple[str, ...] = ()
    invisible_effects: Mapping[str, str]
    flights_us: tuple[tuple[int, int], ...] = ()
    rebuilt: Rebuilt | None = None
    skipped_rows: int = 0
    cut: tuple[Cut, ...] = ()

    @classmethod
    def of(
        cls,
        recording: Recording,
        effects: Mapping[str, Effect],
        motor_lag_s: float,
        flights_us: tuple[tuple[int, int], ...],
    ) -> Visible:
        """Return it for a recording of a vehicle with this motor lag, s, and these times in the air."""
        from trimtab.host.imports.visibility import invisible_effects, unknown_words

        return cls(
            unknown=tuple(unknown_words(recording, motor_lag_s)),
            invisible_effects=invisible_effects(effects, recording, motor_lag_s),
            flights_us=flights_us,
            rebuilt=recording.rebuilt,
            skipped_rows=recording.skipped_rows,
            cut=recording.cut,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, times in s."""
        return {
            "unknown": list(self.unknown),
            "invisible_effects": dict(self.invisible_effects),
            "flights_s": [[begin * 1e-6, end * 1e-6] for begin, end in self.flights_us],
            "rebuilt": None if self.rebuilt is None else asdict(self.rebuilt),
            "skipped_rows": self.skipped_rows,
            "cut": [[part.begin_us * 1e-6, part.end_us * 1e-6, part.reason] for part in self.cut],
        }


@dataclass(frozen=True, kw_only=True)
class Imported:
    """An imported log.

    Attributes
    ----------
    log
        The flight log that was written.
    flight
        Its content.
    format, recognised
        Format of the foreign log, and whether it was recognised.
    topics
        What the foreign log holds: names, numbers of samples and rates in Hz.
    messages
        Number of messages written, by topic.
    declared_mass_kg
        Mass that the foreign log declares, kg; None if it declares none.
    differing
        Sentences on what does not fit the vehicle file.
    notes
        Sentences on what is wrong with the foreign log.
    visible
        What the log does not determine, which effects it cannot show, and what was cut.
    """

    log: Path
    flight: Flight
    format: FormatName
    recognised: bool
    topics: tuple[Topic, ...]
    messages: Mapping[str, int]
    declared_mass_kg: float | None
    differing: tuple[str, ...]
    notes: tuple[str, ...]
    visible: Visible

    def to_dict(self) -> dict[str, Any]:
        """Return the object that `trimtab import --json` prints, as plain data."""
        return {
            "format": self.format,
            "recognised": self.recognised,
            "topics": [asdict(topic) for topic in self.topics],
            "log": str(self.log),
            "problem": None,
            "vehicle": self.flight.vehicle.name,
            "duration_s": self.flight.duration_s,
            "messages": dict(self.messages),
            "mass_kg": self.flight.vehicle.mass_kg,
            "differing": list(self.differing),
            "notes": list(self.notes),
            **self.visible.to_dict(),
        }

    def _repr_html_(self) -> str:
        hidden = self.visible.invisible_effects
        return card(
            f"Imported {self.log.name}",
            [
                ("format", self.format),
                ("vehicle", self.flight.vehicle.name),
                ("duration", f"{self.flight.duration_s:.2f} s"),
                ("unknown", ", ".join(self.visible.unknown) or None),
                ("rebuilt", None if self.visible.rebuilt is None else str(self.visible.rebuilt)),
                *(("differs", line) for line in self.differing),
            ],
            table(("invisible effect", "reason"), hidden.items()),
        )


@one_thread_of_algebra()
def import_log(  # noqa: PLR0913 (one keyword for each choice)
    path: str | Path,
    log: str | Path,
    *,
    vehicle: Vehicle | str | Path | None = None,
    format: str | None = None,
    columns: str | Path | None = None,
    topics: str | Path | None = None,
    scrub: bool = False,
    force: bool = False,
    workspace: str | Path | Workspace | None = None,
    command: Sequence[str] = (),
) -> Imported:
    """Convert a foreign flight log to a Trimtab log, as `trimtab import` does.

    Frames and units are converted here: the log holds NED, FRD and SI. The log is written whole or not at
    all.

    Parameters
    ----------
    path
        Foreign log.
    log
        Flight log to write, .mcap.
    vehicle
        Vehicle that flew, or the name or path of its file. It decides the result, so it has no default.
    format
        Format of the foreign log, such as ulog or csv. Default: recognised from the file.
    columns
        TOML file that gives the meaning, unit and frame of each column. For csv.
    topics
        TOML file that names the topics to read. For rosbag.
    scrub
        Leave out where, when and by whom it was flown.
    force
        Overwrite the log.
    workspace
        Folder with vehicles of yours. Default: the current folder.
    command
        Words of the command line, recorded in the log.

    Returns
    -------
    Imported
        The flight, and what its log does not determine.

    Raises
    ------
    ImportFormatError
        If the file does not have the format, or contradicts itself or the vehicle file.
    UsageError, ConfigurationError
        If arguments, the map or the vehicle file cannot be used, or the log exists.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.program import version
    from trimtab.host.effects import load_effects
    from trimtab.host.imports.formats import module
    from trimtab.host.imports.scrub import SOURCE, scrubbed

    given = ForeignLog.of(path, format, columns=columns, topics=topics)
    if given.format == "csv" and columns is None:
        raise UsageError("the csv format needs --columns MAP.toml")
    part = artefacts.reserve_log(log, force)
    try:
        airframe = _vehicle(open_workspace(workspace), vehicle)
        recording = given.read()
        held = module(given.format).contents(given.path)
        provenance = {"version": version()}
        if scrub:
            recording, airframe = scrubbed(recording), airframe.replace(name=SOURCE)
        else:
            provenance |= _origin(given, command)
        flight, messages, cut, differing = _write(recording, airframe, part, given.format, provenance)
    finally:
        part.discard()
    shown = replace(recording, cut=cut)
    return Imported(
        log=part.target,
        flight=flight,
        format=given.format,
        recognised=given.recognised,
        topics=tuple(held.topics),
        messages=messages,
        declared_mass_kg=recording.mass_kg,
        differing=tuple(differing),
        notes=tuple(held.notes),
        visible=Visible.of(shown, load_effects(), airframe.motor_lag_s, flight.tracking_parts),
    )


def _origin(given: ForeignLog, command: Sequence[str]) -> dict[str, str]:
    """Return what tells where a log comes from: the command, and ids of the source and of its map."""
    from trimtab.host.base import artefacts

    origin = {"source_id": artefacts.content_id_of(given.path)}
    if command:
        words = artefacts.without_options(command, ("-o", "--output"), ("--json", "--force"))
        origin["command"] = artefacts.public_command(words)
    for key, path in (("columns_id", given.columns), ("topics_id", given.topics)):
        if path is not None:
            origin[key] = artefacts.content_id(path.read_bytes())
    return origin


def _vehicle(space: Workspace, vehicle: Vehicle | str | Path | None) -> Vehicle:
    """Return the vehicle that flew. Raises UsageError without one: a wrong one gives wrong physics."""
    from trimtab.host.vehicle import list_vehicles

    if vehicle is None:
        known = ", ".join(list_vehicles(space.root))
        raise UsageError(
            f"which vehicle flew? give --vehicle one of {known}, or the .toml file of another, "
            "made from one of these with its own mass, rotors and motors"
        )
    return vehicle_of(vehicle, space)


def _write(
    recording: Recording, vehicle: Vehicle, part: PartFile, name: FormatName, provenance: dict[str, str]
) -> tuple[Flight, dict[str, int], tuple[Cut, ...], list[str]]:
    """Write and publish the log. Return its flight, messages, what was cut, and what does not fit.

    Raises ImportFormatError if the motors contradict the vehicle.
    """
    from trimtab.host.imports.fitting import check_fit
    from trimtab.host.imports.write import write
    from trimtab.host.log import read_flight

    messages, cut = write(recording, vehicle, part, format=name, provenance=provenance)
    flight = read_flight(part.path)
    differing = check_fit(flight, recording.source)
    part.publish()
    return replace(flight, path=part.target), messages, cut, differing
