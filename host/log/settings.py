"""Settings that differ between two sets of flights: on-board parameters, feed-forward, host controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trimtab.host.log.one_flight import Flight

Setting = float | str

FEEDFORWARD, HOST_CONTROLLER = "feed-forward", "controller on the host"
"""Names of the two settings that are no parameters. Their values are ids, or NONE."""

NONE = "none"

_SHOWN = 8
"""Number of settings that a line names."""


@dataclass(frozen=True, kw_only=True)
class ChangedSetting:
    """A setting that differs between two sets of flights.

    Attributes
    ----------
    name
        Name of a parameter on board, FEEDFORWARD or HOST_CONTROLLER.
    before, after
        Its distinct values in each set, sorted. Empty if the firmware of that set does not have it.
    """

    name: str
    before: tuple[Setting, ...]
    after: tuple[Setting, ...]


def settings_of(flight: Flight) -> dict[str, Setting] | None:
    """Return the settings that a flight was flown with; None if its log does not record them."""
    if flight.firmware_parameters is None:
        return None
    control = flight.host_control
    return {
        **flight.firmware_parameters,
        FEEDFORWARD: flight.metadata.get("feedforward_id", NONE),
        HOST_CONTROLLER: NONE if control is None else " ".join(filter(None, control.identity)),
    }


def changed_between(before: Sequence[Flight], after: Sequence[Flight]) -> tuple[ChangedSetting, ...] | None:
    """Return `changed_settings` of two sets of flights."""
    return changed_settings(list(map(settings_of, before)), list(map(settings_of, after)))


def changed_settings(
    before: Sequence[Mapping[str, Setting] | None], after: Sequence[Mapping[str, Setting] | None]
) -> tuple[ChangedSetting, ...] | None:
    """Return the settings of which the distinct values differ between two sets of flights.

    before, after: `settings_of` each flight. Returns None if no flight of one set records its settings.
    """
    sets = [[settings for settings in each if settings is not None] for each in (before, after)]
    if not all(sets):
        return None
    names = dict.fromkeys(name for each in sets for settings in each for name in settings)
    changes = []
    for name in names:
        first, second = (
            tuple(sorted({settings[name] for settings in each if name in settings})) for each in sets
        )
        if first != second:
            changes.append(ChangedSetting(name=name, before=first, after=second))
    return tuple(changes)


def settings_json(
    settings: Sequence[ChangedSetting] | None, sides: tuple[str, str]
) -> list[dict[str, Any]] | None:
    """Return the settings that differ as plain data, with the keys `sides` for the two sets."""
    if settings is None:
        return None
    return [{"name": each.name, sides[0]: list(each.before), sides[1]: list(each.after)} for each in settings]


def settings_lines(settings: Sequence[ChangedSetting] | None, sides: tuple[str, str]) -> list[str]:
    """Return one line of text on the settings that differ; none if that is not known.

    sides: words for the two sets, such as "before" and "after".
    """
    if settings is None:
        return []
    if not settings:
        return ["settings on board: the same"]
    texts = [
        f"{setting.name} {_listed(setting.before)} {sides[0]}, {_listed(setting.after)} {sides[1]}"
        for setting in settings[:_SHOWN]
    ]
    more = len(settings) - len(texts)
    return [f"settings on board that differ: {'; '.join(texts)}{f'; and {more} more' if more else ''}"]


def _listed(values: Sequence[Setting]) -> str:
    texts = [value if isinstance(value, str) else f"{value:.6g}" for value in values]
    return " and ".join(texts) or "not there"
