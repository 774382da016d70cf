"""Generate docs/reference/manoeuvres.md from the shipped routes and the effects that they separate.

`python docs/generators/manoeuvres.py FILE` writes it. A test compares the page with the code.
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
from trimtab.host.trace.evidence import DisturbanceVariances
from trimtab.host.trace.next_flight.information import Instruments, information
from trimtab.host.trace.next_flight.manoeuvres import Manoeuvre, manoeuvres
from trimtab.host.trace.next_flight.separation import separation
from trimtab.host.trace.parameters import space
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.vehicle import Vehicle, load_vehicle

INSTRUMENTS = Instruments(
    sigma=np.array([1.0e-3, 5.15e-3, 6.4e-3, 0.0255]),
    shares=np.ones(3),
    voltage=np.array([1.0, -0.001]),
    process=DisturbanceVariances(
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
    """Two effects to separate. If `keys` are given, only these parameters of the first leave neutral."""

    effect: str
    alias: str
    keys: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Return the pair as the head of a table column."""
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

These routes separate effects that are easily confused. `trimtab plan NAME` plans one. If logs cannot decide
between two effects, [`trimtab trace`](../guide/tracing.md) chooses among these routes and those of the
workspace. It considers only routes that the vehicle can fly within its limits and geofence.

| route | time | purpose |
|---|---|---|
"""

_TABLE_HEAD = f"""
## What each route separates

The table gives the separation of two effects in sigma: how far the first effect, of typical size, stands out
when the second may take any size. It applies to {FLIGHT_S:g} s along the route. The vehicle is the nominal
`research` vehicle. Camera, gyro, accelerometer and turbulence are simulated by default settings, wind comes
with a drag of typical size, and the voltage falls by 0.1 % a second. All other parameters move within their
tolerance.

A separation of about {DETECTABLE} is needed. It grows with the square root of time and in proportion to the
effect. The figures come from a linearisation and assume a plant of the library's form: take them as upper
bounds.

"""


def sigmas(vehicle: Vehicle, known: Mapping[str, Manoeuvre]) -> dict[str, tuple[float, ...]]:
    """Return the separation of each of PAIRS, by route, for FLIGHT_S along it."""
    chosen = space(vehicle, load_effects())
    form = SegmentModel(vehicle, chosen, dt_s=DT_S, in_newton=False, rate_driven=False)
    with_drag = np.zeros(len(chosen.columns))
    with_drag[list(chosen.groups["linear-drag"])] = 1.0
    separations = {}
    for name, candidate in known.items():
        per_route = information(form, candidate.flat, with_drag, INSTRUMENTS)
        if per_route is None:
            continue
        row = []
        for pair in PAIRS:
            indices = [
                i for i in chosen.groups[pair.effect] if not pair.keys or chosen.columns[i].key in pair.keys
            ]
            z = np.zeros(len(chosen.columns))
            z[indices] = 1.0 / np.sqrt(len(indices))
            present = ("linear-drag",) if pair.effect == "wind" else ()
            share = FLIGHT_S / candidate.total_time_s
            row.append(separation(chosen, share * per_route, present, z, pair.effect, pair.alias))
        separations[name] = tuple(row)
    return separations


def page() -> str:
    """Return the page as Markdown: the shipped routes with their purpose, and what each route separates."""
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
