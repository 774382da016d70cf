"""Two groups of flights compared: tracking errors, paired by the reference that both groups flew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from trimtab.host.compare.statistics import Difference, paired_difference, unpaired_difference
from trimtab.host.log import (
    FAILSAFE_WORDS,
    ChangedSetting,
    LogError,
    Setting,
    changed_settings,
    read_flight,
    settings_json,
    settings_of,
    topics,
)
from trimtab.host.log.tracking import feedforward_faded_s, tracking_error
from trimtab.host.vehicle import Vehicle

Over = Literal["references", "flights"]
"""What an interval is over: references that both groups flew, or flights of the only one."""

FIGURES = ("error_mean_m", "error_rmse_m", "error_max_m", "feedforward_faded_s")


@dataclass(frozen=True, kw_only=True)
class FlightFigures:
    """The figures of one flight by the names in FIGURES; without those that the log does not give."""

    log: str
    id: str
    reference: str | None
    vehicle: Vehicle
    settings: Mapping[str, Setting] | None
    figures: Mapping[str, float]
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ReferencePair:
    """A reference that both groups flew, with the logs of each and the mean of each figure in a and b."""

    reference: str
    a_logs: tuple[str, ...]
    b_logs: tuple[str, ...]
    figures: Mapping[str, tuple[float, float]]

    def to_dict(self) -> dict[str, Any]:
        """Return the pair as plain data for JSON."""
        return {
            "reference": self.reference,
            "a_logs": list(self.a_logs),
            "b_logs": list(self.b_logs),
            "figures": {name: {"a": a, "b": b, "difference": b - a} for name, (a, b) in self.figures.items()},
        }


@dataclass(frozen=True, kw_only=True)
class FigureComparison:
    """A figure of both groups, and the difference b minus a.

    a, b: means over the common references; over all flights if there are none, and `difference` is then None.
    """

    figure: str
    a: float
    b: float
    difference: Difference | None

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        difference = None if self.difference is None else self.difference.to_dict()
        return {"figure": self.figure, "a": self.a, "b": self.b, "difference": difference}


@dataclass(frozen=True, kw_only=True)
class LogsComparison:
    """Two groups of flights.

    over: what the intervals are over; None without a common reference. a_only, b_only: logs whose reference
    the other group did not fly, or that have none. settings: those on board that differ; None if the logs of
    one group do not record them.
    """

    pairs: tuple[ReferencePair, ...]
    over: Over | None
    figures: tuple[FigureComparison, ...]
    a_only: tuple[str, ...]
    b_only: tuple[str, ...]
    settings: tuple[ChangedSetting, ...] | None
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        return {
            "over": self.over,
            "pairs": [pair.to_dict() for pair in self.pairs],
            "figures": [figure.to_dict() for figure in self.figures],
            "a_only": list(self.a_only),
            "b_only": list(self.b_only),
            "settings": settings_json(self.settings, ("a", "b")),
            "notes": list(self.notes),
        }


def read_figures(paths: Sequence[Path], *, from_folder: bool) -> tuple[list[FlightFigures], list[str]]:
    """Return the figures of flights, and a note for each log of a folder that cannot be read.

    Raises LogError for an unreadable log that is named, or if none of a folder's can be read.
    """
    read, notes = [], []
    for path in paths:
        try:
            read.append(_figures(path))
        except LogError as error:
            if not from_folder:
                raise
            notes.append(f"left out: {error}")
    if paths and not read:
        raise LogError(f"{paths[0].parent}: none of its logs can be read; {notes[0]}")
    return read, notes


def _figures(path: Path) -> FlightFigures:
    flight = read_flight(path, leave_out=[topics.FC_CONTROL])  # the figures do not use this topic
    error, faded_s = tracking_error(flight), feedforward_faded_s(flight)
    figures = {}
    if error is not None:
        figures = {
            "error_mean_m": error.mean_m,
            "error_rmse_m": error.rmse_m,
            "error_max_m": error.max_m,
        }
    if faded_s is not None:
        figures["feedforward_faded_s"] = faded_s
    notes = []
    if error is None:
        notes.append(f"{path}: no reference or no tracking phase, so no tracking error")
    elif not flight.tracking_whole:
        notes.append(f"{path}: the reference was not flown to its end; the error is of the part flown")
    if flight.failsafe is not None:
        notes.append(f"{path}: ended by failsafe ({FAILSAFE_WORDS.get(flight.failsafe, flight.failsafe)})")
    return FlightFigures(
        log=str(path),
        id=flight.id,
        reference=flight.reference_id,
        vehicle=flight.vehicle,
        settings=settings_of(flight),
        figures=figures,
        notes=tuple(notes),
    )


def compare_logs(a: Sequence[FlightFigures], b: Sequence[FlightFigures]) -> LogsComparison:
    """Return what differs between two groups of flights, b minus a.

    Flights of one reference are averaged, so that each reference is one pair. If there is only one common
    reference, its flights are compared without pairs.
    """
    first, second = _by_reference(a), _by_reference(b)
    common = [reference for reference in first if reference in second]
    pairs = tuple(_pair(reference, first[reference], second[reference]) for reference in common)
    over: Over | None = None if not common else "flights" if len(common) == 1 else "references"
    figures = [
        _figure(name, a, b) if over is None else _paired_figure(name, pairs, first, second)
        for name in FIGURES
    ]
    both = {flight.id for flight in a} & {flight.id for flight in b}
    notes = [note for flight in (*a, *b) for note in flight.notes]
    notes += [f"{flight.log}: this flight is in both" for flight in a if flight.id in both]
    if {flight.vehicle.id for flight in a} != {flight.vehicle.id for flight in b}:
        notes.append("the flights are not of the same vehicle")
    return LogsComparison(
        pairs=pairs,
        over=over,
        figures=tuple(figure for figure in figures if figure is not None),
        a_only=tuple(flight.log for flight in a if flight.reference not in common),
        b_only=tuple(flight.log for flight in b if flight.reference not in common),
        settings=changed_settings([flight.settings for flight in a], [flight.settings for flight in b]),
        notes=tuple(dict.fromkeys(notes)),
    )


def _figure(name: str, a: Sequence[FlightFigures], b: Sequence[FlightFigures]) -> FigureComparison | None:
    """Return the means of a figure over all flights that have it; None if one side has none."""
    sides = [[flight.figures[name] for flight in side if name in flight.figures] for side in (a, b)]
    if not all(sides):
        return None
    of_a, of_b = (float(np.mean(side)) for side in sides)
    return FigureComparison(figure=name, a=of_a, b=of_b, difference=None)


def _paired_figure(
    name: str,
    pairs: Sequence[ReferencePair],
    first: Mapping[str, Sequence[FlightFigures]],
    second: Mapping[str, Sequence[FlightFigures]],
) -> FigureComparison | None:
    """Return a figure over the pairs that have it, or over the flights of the only one; None without any."""
    means = [pair.figures[name] for pair in pairs if name in pair.figures]
    if not means:
        return None
    if len(pairs) == 1:
        of_a, of_b = (
            [flight.figures[name] for flight in side[pairs[0].reference]] for side in (first, second)
        )
        difference = unpaired_difference(of_a, of_b)
    else:
        difference = paired_difference([b - a for a, b in means])
    mean_a, mean_b = np.mean(means, axis=0)
    return FigureComparison(figure=name, a=float(mean_a), b=float(mean_b), difference=difference)


def _by_reference(flights: Sequence[FlightFigures]) -> dict[str, list[FlightFigures]]:
    """Return the flights that have a tracking error by their reference."""
    groups: dict[str, list[FlightFigures]] = {}
    for flight in flights:
        if flight.reference is not None and "error_rmse_m" in flight.figures:
            groups.setdefault(flight.reference, []).append(flight)
    return groups


def _pair(reference: str, a: Sequence[FlightFigures], b: Sequence[FlightFigures]) -> ReferencePair:
    """Return the means of the figures that all these flights have."""
    names = [name for name in FIGURES if all(name in flight.figures for flight in (*a, *b))]
    return ReferencePair(
        reference=reference,
        a_logs=tuple(flight.log for flight in a),
        b_logs=tuple(flight.log for flight in b),
        figures={
            name: (
                float(np.mean([flight.figures[name] for flight in a])),
                float(np.mean([flight.figures[name] for flight in b])),
            )
            for name in names
        },
    )
