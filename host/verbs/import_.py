"""`trimtab import`: say what a foreign flight log holds, or convert it to a Trimtab log."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.imports.contents import Contents
    from trimtab.host.imports.formats import FormatName
    from trimtab.host.imports.recording import Cut, Recording
    from trimtab.host.log import Flight
    from trimtab.host.vehicle import Vehicle
    from trimtab.host.workspace import Workspace


@dataclass(frozen=True, kw_only=True)
class _Given:
    """A foreign file, its format, and the map that belongs to it."""

    name: FormatName
    path: Path
    columns: Path | None
    topics: Path | None

    def read(self) -> Recording:
        """Return the recording. Raises ImportFormatError for the file, ConfigurationError for the map."""
        from trimtab.host.imports.formats import read

        return read(self.name, self.path, self.columns, self.topics)


@dataclass(frozen=True, kw_only=True)
class _Written:
    """A log that was written: its flight, its messages by topic, what was cut, and what does not fit."""

    flight: Flight
    messages: dict[str, int]
    cut: tuple[Cut, ...]
    differing: list[str]


def command(
    *words: Annotated[str, Parameter(name="[FORMAT] FILE", show_default=False)],
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
    columns: Path | None = None,
    topics: Path | None = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    scrub: bool = False,
    workspace: WorkspaceFolder = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Say what a foreign flight log holds, or convert it to a Trimtab log.

    Parameters
    ----------
    words
        The foreign log, after its format if that is not to be recognised.
    output
        Flight log to write. Without it, nothing is converted.
    columns
        TOML file that gives the meaning of each column. For csv.
    topics
        TOML file that names the topics to read. For rosbag.
    vehicle
        Vehicle that flew: its file, by name or path. It has no default, because it decides the result.
    scrub
        Leave out where, when and by whom it was flown: absolute positions, dates, file and vehicle names.
    """
    from trimtab.host.base import artefacts
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit

    name, path = _format_and_file(words)
    recognised = len(words) == 1
    if columns is not None and name != "csv":
        raise UsageError(f"--columns is for csv, and {path.name} is {name}")
    if topics is not None and name != "rosbag":
        raise UsageError(f"--topics is for rosbag, and {path.name} is {name}")
    given = _Given(name=name, path=path, columns=columns, topics=topics)
    if output is None:
        emit({"format": name, "recognised": recognised, **_look(given)}, json)
        return
    if name == "csv" and columns is None:
        raise UsageError("the csv format needs --columns MAP.toml")
    artefacts.check_log(output, force)
    answer = _convert(given, output, vehicle, workspace, scrub)
    emit({"format": name, "recognised": recognised, **answer}, json)


def _format_and_file(words: tuple[str, ...]) -> tuple[FormatName, Path]:
    """Return the given or recognised format, and the file."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.imports.formats import FORMATS, recognise

    if len(words) not in (1, 2):
        raise UsageError("give one file, as in trimtab import FILE or trimtab import FORMAT FILE")
    path = Path(words[-1])
    if len(words) == 1:
        return recognise(path), path
    for name in FORMATS:
        if name == words[0]:
            return name, path
    raise UsageError(f"{words[0]}: not a format; give one of {', '.join(FORMATS)}")


def _look(given: _Given) -> dict[str, Any]:
    """Print what the file holds, and return it."""
    from trimtab.host.base.output import say
    from trimtab.host.imports.airborne import airborne
    from trimtab.host.imports.formats import LOGGING_PROFILES, module
    from trimtab.host.imports.plausible import consistent_span
    from trimtab.host.imports.recording import ImportFormatError

    held = module(given.name).contents(given.path)
    say(f"{given.path.name}: {given.name}, {held.duration_s:.1f} s, {len(held.topics)} topics")
    for topic in held.topics:
        say(f"  {topic.name}  {topic.count} samples" + (f", {topic.rate_hz:.1f} Hz" if topic.rate_hz else ""))
    for note in held.notes:
        say(f"note: {note}")
    recording, problem = None, None
    if given.name == "csv" and given.columns is None:
        problem = "a CSV file needs a column map: give it with --columns MAP.toml"
    else:
        try:
            recording = given.read()
            _, cut = consistent_span(recording, airborne(recording))
            recording = replace(recording, cut=(*recording.cut, *cut))
        except ImportFormatError as error:
            problem = str(error)
    if problem is not None:
        say(f"cannot be imported: {problem}")
    answer = {"topics": _topics(held), "log": None, "problem": problem, **_shown(recording)}
    profile = LOGGING_PROFILES.get(given.name)
    if profile is not None and (problem is not None or answer["invisible_effects"]):
        say(f"to show more, log with {profile}")
    if problem is None:
        say("import it with --vehicle VEHICLE -o LOG.mcap")
    return answer


def _convert(
    given: _Given, output: Path, vehicle: str | None, workspace: Path | None, scrub: bool
) -> dict[str, Any]:
    """Write the flight log, print what it holds, and return that."""
    from trimtab.host.base import artefacts
    from trimtab.host.base.output import say, warn
    from trimtab.host.imports.formats import module
    from trimtab.host.imports.scrub import SOURCE, scrubbed
    from trimtab.host.workspace import open_workspace

    airframe = _vehicle(open_workspace(workspace), vehicle)
    recording = given.read()
    topics = _topics(module(given.name).contents(given.path))
    provenance = {"version": artefacts.version()}
    if scrub:
        recording, airframe = scrubbed(recording), airframe.replace(name=SOURCE)
    else:
        provenance |= _origin(given)
    written = _write(recording, airframe, output, given.name, provenance)
    flight = written.flight
    mass = f", {recording.mass_kg:g} kg as declared" if recording.mass_kg is not None else ""
    say(
        f"{output}: {flight.duration_s:.1f} s of {flight.vehicle.name}{mass}, "
        f"{sum(written.messages.values())} messages"
    )
    for line in written.differing:
        warn(line)
    return {
        "topics": topics,
        "log": str(output),
        "problem": None,
        "vehicle": flight.vehicle.name,
        "duration_s": flight.duration_s,
        "messages": written.messages,
        "mass_kg": flight.vehicle.mass_kg,
        "differing": written.differing,
        **_shown(replace(recording, cut=written.cut), airframe),
    }


def _origin(given: _Given) -> dict[str, str]:
    """Return what tells where a log comes from: the command, and ids of the source and of its map."""
    import sys

    from trimtab.host.base import artefacts

    words = artefacts.without_options(sys.argv[1:], ("-o", "--output"), ("--json", "--force"))
    origin = {"command": artefacts.public_command(words), "source_id": artefacts.content_id_of(given.path)}
    for key, path in (("columns_id", given.columns), ("topics_id", given.topics)):
        if path is not None:
            origin[key] = artefacts.content_id(path.read_bytes())
    return origin


def _topics(held: Contents) -> list[dict[str, Any]]:
    """Return the topics of the file for the answer."""
    return [asdict(topic) for topic in held.topics]


def _shown(recording: Recording | None, vehicle: Vehicle | None = None) -> dict[str, Any]:
    """Print and return what the recording does not determine and which effects it cannot show."""
    from trimtab.host.base.output import say
    from trimtab.host.effects import load_effects
    from trimtab.host.imports.visibility import TYPICAL_LAG_S, invisible_effects, unknown_words

    effects = load_effects()
    if recording is None:
        hidden = {name: "not imported" for name in effects}
        return {"unknown": [], "invisible_effects": hidden, "skipped_rows": 0, "cut": []}
    lag_s = TYPICAL_LAG_S if vehicle is None else vehicle.motor_lag_s
    unknown = unknown_words(recording, lag_s)
    hidden = invisible_effects(effects, recording, lag_s)
    if unknown:
        say(f"unknown: {', '.join(unknown)}")
    for reason in dict.fromkeys(hidden.values()):
        say(f"invisible, {reason}: {', '.join(name for name, why in hidden.items() if why == reason)}")
    if recording.skipped_rows:
        say(f"skipped: {recording.skipped_rows} rows without finite numbers")
    cut = [[part.begin_us * 1e-6, part.end_us * 1e-6, part.reason] for part in recording.cut]
    for begin_s, end_s, reason in cut:
        say(f"cut from {begin_s:.2f} to {end_s:.2f} s: {reason}")
    return {
        "unknown": list(unknown),
        "invisible_effects": hidden,
        "skipped_rows": recording.skipped_rows,
        "cut": cut,
    }


def _vehicle(workspace: Workspace, name: str | None) -> Vehicle:
    """Return the vehicle that flew. Raises UsageError without a name: a wrong one gives wrong physics."""
    from trimtab.host.base.errors import UsageError
    from trimtab.host.vehicle import list_vehicles

    if name is None:
        known = ", ".join(list_vehicles(workspace.root))
        raise UsageError(
            f"which vehicle flew? give --vehicle one of {known}, or the .toml file of another, "
            "made from one of these with its own mass, rotors and motors"
        )
    return workspace.vehicle(name)


def _write(
    recording: Recording, vehicle: Vehicle, output: Path, name: FormatName, provenance: dict[str, str]
) -> _Written:
    """Write the complete log or nothing. Raises ImportFormatError if the motors contradict the vehicle."""
    from trimtab.host.imports.fitting import check_fit
    from trimtab.host.imports.write import write
    from trimtab.host.log import partial_path, read_flight

    growing = output.with_name(output.name + ".import")
    try:
        messages, cut = write(recording, vehicle, growing, format=name, provenance=provenance)
        flight = read_flight(growing)
        differing = check_fit(flight, recording.source)
        growing.replace(output)
    finally:
        growing.unlink(missing_ok=True)
        partial_path(growing).unlink(missing_ok=True)
    return _Written(flight=flight, messages=messages, cut=cut, differing=differing)
