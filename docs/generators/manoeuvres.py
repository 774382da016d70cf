"""The page on manoeuvres, docs/reference/manoeuvres.md, made from the shipped routes and what they separate.

`python docs/generators/manoeuvres.py FILE` writes it; a test holds the page against the code.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trimtab.host.effects import load_effects
from trimtab.host.route import list_routes, load_route, route_description
from trimtab.host.trace.data.cutting import DT_S
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.evidence import Process
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre, manoeuvres
from trimtab.host.trace.next_flight.separation import Instruments, information, separation
from trimtab.host.trace.parameters import space
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.vehicle import Vehicle, load_vehicle

INSTRUMENTS = Instruments(
    sigma=np.array([1.0e-3, 5.15e-3, 6.4e-3, 0.0255]),
    shares=np.ones(3),
    voltage=np.array([1.0, -0.001]),
    process=Process(
        log_lateral=2.0 * np.log(0.036), log_axial=2.0 * np.log(0.038), log_torque=2.0 * np.log(0.44)
    ),
    in_newton=False,
    rate_driven=False,
)
"""Noise and turbulence of a simulated flight as its log shows them, and a battery that empties."""

DETECTABLE = RULES.detectable_sigma
FLIGHT_S = 12.0


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two effects to be told apart; of the first, `keys` alone leave neutral where they are given."""

    effect: str
    alias: str
    keys: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """The pair in the head of a table."""
        return f"{'.'.join((self.effect, *self.keys))} / {self.alias}"


PAIRS = (
    Pair(effect="wind", alias="frame-tilt"),
    Pair(effect="com-offset", alias="torque-bias"),
    Pair(effect="linear-drag", alias="quadratic-drag"),
    Pair(effect="linear-drag", alias="thrust-inflow", keys=("dz",)),
    Pair(effect="ground-effect", alias="thrust-gain"),
    Pair(effect="motor-lag", alias="actuation-delay"),
    Pair(effect="gyroscopic", alias="inertia"),
    Pair(effect="slung-payload", alias="thrust-gain"),
    Pair(effect="battery-sag", alias="thrust-gain"),
)

_HEAD = """# Manoeuvres

<!-- Made by `make docs` from host/routes; change it there. -->

Routes that tell effects apart. `trimtab plan NAME` plans them; where logs cannot decide between two effects,
[`trimtab trace`](../guide/tracing.md) chooses among them, and among the workspace's own routes, those that
the vehicle can fly within its limits and geofence.

| route | time | what for |
|---|---|---|
"""

_TABLE_HEAD = f"""
## What each separates

Sigma by which the first effect, of typical size, stands out of the second one, whatever size that takes, in
{FLIGHT_S:g} s along the route: nominal `research` vehicle, camera, gyro, accelerometer and turbulence as
simulated by default, wind with a drag of typical size, voltage falling by 0.1 % a second. Everything else
moves within its tolerance. About {DETECTABLE} are needed; sigma grows with the square root of time and in
proportion to the effect. The figures are of a linearisation and know nothing of a plant that is not of the
library's form: take them as upper bounds.

"""


def sigmas(vehicle: Vehicle, known: Mapping[str, Manoeuvre]) -> dict[str, tuple[float, ...]]:
    """By route the separation of each of PAIRS, for FLIGHT_S along it."""
    chosen = space(vehicle, load_effects())
    form = SegmentModel(vehicle, chosen, dt_s=DT_S, in_newton=False, rate_driven=False)
    with_drag = np.zeros(len(chosen.columns))
    with_drag[list(chosen.groups["linear-drag"])] = 1.0
    found = {}
    for name, candidate in known.items():
        told = information(form, candidate.flat, with_drag, INSTRUMENTS)
        if told is None:
            continue
        row = []
        for pair in PAIRS:
            mine = [
                i for i in chosen.groups[pair.effect] if not pair.keys or chosen.columns[i].key in pair.keys
            ]
            z = np.zeros(len(chosen.columns))
            z[mine] = 1.0 / np.sqrt(len(mine))
            present = ("linear-drag",) if pair.effect == "wind" else ()
            share = FLIGHT_S / candidate.total_time_s
            row.append(separation(chosen, share * told, present, z, pair.effect, pair.alias))
        found[name] = tuple(row)
    return found


def page() -> str:
    """Return the page as Markdown: the shipped routes with their purpose, and what each separates."""
    vehicle = load_vehicle("research")
    routes = {name: load_route(name) for name in list_routes()}
    known = {each.route: each for each in manoeuvres(routes, vehicle)}
    purposes = [
        f"| `{name}` | {known[name].total_time_s:.1f} s | {route_description(name)} |" for name in known
    ]
    head = ["route", *(pair.title for pair in PAIRS)]
    rows = [
        [f"`{name}`", *(f"{value:.1f}" for value in values)]
        for name, values in sigmas(vehicle, known).items()
    ]
    table = [head, ["---"] * len(head), *rows]
    return (
        _HEAD
        + "\n".join(purposes)
        + "\n"
        + _TABLE_HEAD
        + "\n".join(f"| {' | '.join(cells)} |" for cells in table)
        + "\n"
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
