"""`trimtab import`: say what a foreign flight log holds, or convert it to a Trimtab log."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from trimtab.host.verbs.options import Force, Json, Trust, WorkspaceFolder

if TYPE_CHECKING:
    from trimtab.host.api.imports import ForeignLog, Imported, Visible
    from trimtab.host.base.errors import TrimtabError


def command(  # noqa: PLR0913 (one keyword for each option)
    *words: Annotated[str, Parameter(name="[FORMAT] FILE", show_default=False)],
    output: Annotated[Path | None, Parameter(name=["-o", "--output"])] = None,
    columns: Path | None = None,
    topics: Path | None = None,
    vehicle: Annotated[str | None, Parameter(name="--vehicle")] = None,
    scrub: bool = False,
    workspace: WorkspaceFolder = None,
    trust: Trust = False,
    json: Json = False,
    force: Force = False,
) -> None:
    """Say what a foreign flight log holds, or convert it to a Trimtab log.

    A file that cannot be imported ends with the same exit code with and without -o.

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
    import sys

    from trimtab.host.api.imports import ForeignLog, import_log
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import emit
    from trimtab.host.workspace import open_workspace

    if len(words) not in (1, 2):
        raise UsageError("give one file, as in trimtab import FILE or trimtab import FORMAT FILE")
    path, format = Path(words[-1]), words[0] if len(words) == 2 else None
    if output is None:
        given = ForeignLog.of(path, format, columns=columns, topics=topics)
        answer, problem = _look(given)
        emit({"format": given.format, "recognised": given.recognised, **answer}, json)
        if problem is not None:
            raise problem
        return
    imported = import_log(
        path,
        output,
        vehicle=vehicle,
        format=format,
        columns=columns,
        topics=topics,
        scrub=scrub,
        force=force,
        workspace=open_workspace(workspace, trusted=trust),
        command=sys.argv[1:],
    )
    _print(imported)
    emit(imported.to_dict(), json)


def _print(imported: Imported) -> None:
    """Print what was written and what it can show."""
    from trimtab.host.base.output import say, warn

    flight, mass_kg = imported.flight, imported.declared_mass_kg
    mass = "" if mass_kg is None else f", {mass_kg:g} kg as declared"
    say(
        f"{imported.log}: {flight.duration_s:.1f} s of {flight.vehicle.name}{mass}, "
        f"{sum(imported.messages.values())} messages"
    )
    say(*(f"note: {note}" for note in imported.notes))
    for line in imported.differing:
        warn(line)
    _print_visible(imported.visible)


def _look(given: ForeignLog) -> tuple[dict[str, Any], TrimtabError | None]:
    """Print what the file holds. Return it, and why it cannot be imported."""
    from trimtab.host.api.imports import Visible
    from trimtab.host.base.errors import UsageError
    from trimtab.host.base.output import say
    from trimtab.host.effects import load_effects
    from trimtab.host.imports.airborne import airborne
    from trimtab.host.imports.formats import LOGGING_PROFILES, module
    from trimtab.host.imports.plausible import consistent_parts
    from trimtab.host.imports.recording import ImportFormatError
    from trimtab.host.imports.visibility import TYPICAL_LAG_S

    held = module(given.format).contents(given.path)
    say(f"{given.path.name}: {given.format}, {held.duration_s:.1f} s, {len(held.topics)} topics")
    for topic in held.topics:
        say(f"  {topic.name}  {topic.count} samples" + (f", {topic.rate_hz:.1f} Hz" if topic.rate_hz else ""))
    for note in held.notes:
        say(f"note: {note}")
    effects = load_effects()
    problem: TrimtabError | None = None
    visible = Visible(invisible_effects={name: "not imported" for name in effects})
    if given.format == "csv" and given.columns is None:
        problem = UsageError("a CSV file needs a column map: give it with --columns MAP.toml")
    else:
        try:
            recording = given.read()
            flights_us, cut = consistent_parts(recording, airborne(recording))
            recording = replace(recording, cut=(*recording.cut, *cut))
            visible = Visible.of(recording, effects, TYPICAL_LAG_S, flights_us)
        except ImportFormatError as error:
            problem = error
    if problem is None:
        _print_visible(visible)
    profile = LOGGING_PROFILES.get(given.format)
    hidden = [name for name in visible.invisible_effects if not effects[name].noise_dependent]
    if profile is not None and (problem is not None or hidden):
        say(f"to show more, log with {profile}")
    if problem is None:
        say("import it with --vehicle VEHICLE -o LOG.mcap")
    answer = {
        "topics": [asdict(topic) for topic in held.topics],
        "notes": list(held.notes),
        "log": None,
        "problem": None if problem is None else str(problem),
        **visible.to_dict(),
    }
    return answer, problem


def _print_visible(visible: Visible) -> None:
    """Print its flights, what it does not determine, which effects it cannot show, and what was cut."""
    from trimtab.host.base.output import say

    hidden = visible.invisible_effects
    if len(visible.flights_us) > 1:
        times = ", ".join(f"{a * 1e-6:.2f} to {b * 1e-6:.2f} s" for a, b in visible.flights_us)
        say(f"{len(visible.flights_us)} flights: {times}")
    if visible.rebuilt is not None:
        say(f"rebuilt, since it was not logged: {visible.rebuilt}")
    if visible.unknown:
        say(f"unknown: {', '.join(visible.unknown)}")
    for reason in dict.fromkeys(hidden.values()):
        say(f"invisible, {reason}: {', '.join(name for name, why in hidden.items() if why == reason)}")
    if visible.skipped_rows:
        say(f"skipped: {visible.skipped_rows} rows without finite numbers")
    for part in visible.cut:
        say(f"cut from {part.begin_us * 1e-6:.2f} to {part.end_us * 1e-6:.2f} s: {part.reason}")
