"""A vehicle file with typical values, from the few facts of a quadrotor that its owner knows.

Every rule below is a constant with its source. `docs/guide/vehicle.md` lists them with the published vehicles
that they were compared with. What nobody measured is a guess: its tolerance in the file is wide, so that
tracing moves the value before it names an effect.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle.model import Rotor

INERTIA_SHARE = (0.21, 0.21, 0.38)
"""Moments of inertia over mass times the arm length squared. Published: 0.17 to 0.26, 0.32 to 0.49."""

TORQUE_PER_PITCH = 0.19
"""Reaction torque over thrust and pitch. 1/(2 pi) is the work of one turn that moves the air by one pitch;
drag of the blades adds a fifth."""

PITCH_SHARE = 0.7
"""Pitch over diameter, if only the diameter is known. Sold for small quadrotors: 0.5 to 0.9."""

THRUST_COEFFICIENT = (0.06, 0.09)
"""C_T = a + b pitch / diameter, in T = C_T rho n^2 D^4. Static tests of small propellers: 0.09 to 0.15."""

LOADED_SPEED = 0.65
"""Speed at full command over kv times the full voltage: what the load of the propeller leaves."""

AIR_DENSITY_KG_M3 = 1.2

THRUST_TO_WEIGHT = ((0.06, 2.0), (1.2, 4.0), (math.inf, 2.2))
"""Mass below which, kg, four rotors at full command lift this multiple of the weight; used without kv."""

CELLS = ((0.06, 1), (0.15, 2), (0.4, 3), (1.5, 4), (math.inf, 6))
"""Mass below which, kg, the battery has this number of cells."""

BATTERY_WH_PER_KG = 30.0
"""Energy over take-off mass: a fifth of it is a battery of 150 Wh/kg."""

CELL_V = (3.7, 4.2, 3.3)
"""Voltage of a lithium polymer cell: mean, full, empty."""

CURVE_BY_DIAMETER_IN = ((5.0, 0.55), (10.0, 0.65), (20.0, 0.75))
"""Quadratic part of the thrust curve, linear in between: ArduPilot's advice for MOT_THST_EXPO."""

LAG_LEAST_S, LAG_PER_DIAMETER_S_PER_M = 0.035, 0.2
"""Time constant of the rotors: at least the first, and the second times the diameter."""

FIRST_LIMITS = {"speed_m_s": 5.0, "rate_rad_s": 5.0, "yaw_rate_rad_s": 2.5, "jerk_m_s3": 40.0, "room_m": 5.0}
"""Limits for the first flights, the same for every vehicle."""

TILT_MOST_DEG = 50.0
HEADROOM = (0.08, 0.85)
HOVER_SHARE_LEAST, HOVER_SHARE_MOST = 0.05, 0.65
"""Share of its greatest thrust at which a rotor hovers. Above, too little is left to control the attitude;
below, one of the facts is wrong."""

RANGES = {
    "mass_kg": (0.015, 10.0),
    "arm_m": (0.02, 1.0),
    "diameter_in": (1.0, 40.0),
    "pitch_in": (0.3, 30.0),
    "kv": (50.0, 30000.0),
    "cells": (1, 24),
    "thrust_max_n": (0.02, 500.0),
}
"""Lowest and highest value of each fact."""

QUAD_X = ((1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw"), (-1, 1, "cw"))
"""Sides (forward, right) and spins in the order of `research`, PX4 and ArduPilot."""

_INCH_M = 0.0254
_DATA_SHEET_SIGMA = 0.05
"""One sigma of the relative error of a greatest thrust that the owner states."""
_WEIGHED_SIGMA = 0.004
"""One sigma of the relative error of a mass that the owner states."""


@dataclass(frozen=True, kw_only=True)
class Propeller:
    """A propeller as its name says it. known_pitch: whether the name says the pitch, or a rule."""

    diameter_m: float
    pitch_m: float
    known_pitch: bool = True


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What is known of a quadrotor. None: not known, a rule gives it.

    `thrust_max_n` is the greatest thrust of one rotor, N. `hover_share` is the share of it at which a rotor
    hovers, `thrust_curve` [c1, c2] of the vehicle file. `sources` are lines for the head of the file.
    """

    mass_kg: float
    propeller: Propeller
    rotors: Sequence[Rotor]
    kv_rpm_v: float | None = None
    cells: int | None = None
    thrust_max_n: float | None = None
    hover_share: float | None = None
    thrust_curve: tuple[float, float] | None = None
    sources: Sequence[str] = ()


def check_range(key: str, value: float, option: str) -> None:
    """Raise UsageError if a fact is outside its range."""
    low, high = RANGES[key]
    if not low <= value <= high:
        raise UsageError(f"{option} {value:g}: give a value from {low:g} to {high:g}")


def parse_propeller(text: str) -> Propeller:
    """Return the propeller of a name: 5x4.3 or 5 in inches, 127mm. Raises UsageError."""
    number = r"(\d{1,3}(?:\.\d{1,3})?)"
    match = re.fullmatch(f"{number}(?:x{number}|(mm))?", text, flags=re.ASCII)
    if match is None:
        raise UsageError(
            f"--propeller {text}: give DIAMETERxPITCH or DIAMETER in inches, or the diameter in mm, such as "
            "5x4.3, 5 or 127mm"
        )
    diameter = float(match[1]) * (1.0 if match[3] is None else 1e-3 / _INCH_M)
    pitch = PITCH_SHARE * diameter if match[2] is None else float(match[2])
    check_range("diameter_in", diameter, "the diameter of --propeller in inches,")
    check_range("pitch_in", pitch, "the pitch of --propeller")
    return Propeller(diameter_m=diameter * _INCH_M, pitch_m=pitch * _INCH_M, known_pitch=match[2] is not None)


def square_rotors(arm_m: float) -> tuple[Rotor, ...]:
    """Return the rotors of a quadrotor X whose arms are as long and at 45 degrees."""
    side = arm_m * math.sqrt(0.5)
    return tuple(
        Rotor.model_validate({"position_m": (x * side, y * side, 0.0), "spin": spin}) for x, y, spin in QUAD_X
    )


def arm_length(rotors: Sequence[Rotor]) -> float:
    """Return the mean horizontal distance of the rotors from the centre of mass, m."""
    return sum(math.hypot(*rotor.position_m[:2]) for rotor in rotors) / len(rotors)


def typical_file(name: str, facts: Facts) -> str:
    """Return the TOML text of a vehicle with these facts and typical values for the rest.

    Every value has its source beside it. The text is not checked yet: read it with `parse_vehicle`. Raises
    UsageError for facts that contradict each other.
    """
    propeller, arm_m, mass = facts.propeller, arm_length(facts.rotors), facts.mass_kg
    _check_room(facts)
    cells = facts.cells or _by_mass(CELLS, mass)
    thrust_max_n, thrust_source, gain_sigma = _greatest_thrust(facts, cells)
    hover_share = mass * GRAVITY / (4.0 * thrust_max_n)
    if not HOVER_SHARE_LEAST <= hover_share <= HOVER_SHARE_MOST:
        raise UsageError(
            f"these rotors lift {1.0 / hover_share:.3g} times the weight, not "
            f"{1.0 / HOVER_SHARE_MOST:.2g} to {1.0 / HOVER_SHARE_LEAST:.2g}; "
            "check mass, thrust, propeller, kv and cells"
        )
    c2 = round(_curve(propeller.diameter_m), 2)
    curve, curve_source = (round(1.0 - c2, 2), c2), "guess: ArduPilot's advice for this diameter"
    if facts.thrust_curve is not None:
        curve, curve_source = facts.thrust_curve, "the parameter file"
    lag_s = max(LAG_LEAST_S, LAG_PER_DIAMETER_S_PER_M * propeller.diameter_m)
    inertia = [share * mass * arm_m**2 for share in INERTIA_SHARE]
    mean_v, full_v, empty_v = (cells * volts for volts in CELL_V)
    blocks = [
        *(f"# {line}" for line in _head(facts)),
        f'name = "{name}"',
        f"mass_kg = {mass!r} # given",
        f"inertia_kg_m2 = {_list(inertia)} # guess: {_list(INERTIA_SHARE)} m L^2",
        f"thrust_max_n = {_short(thrust_max_n)} # {thrust_source}",
        f"thrust_curve = {list(curve)} # {curve_source}",
        f"torque_per_thrust_m = {_short(TORQUE_PER_PITCH * propeller.pitch_m)} "
        f"# guess: {TORQUE_PER_PITCH} times the pitch",
        f"motor_lag_s = {_short(lag_s)} "
        f"# guess: {LAG_PER_DIAMETER_S_PER_M:g} s/m times the diameter, at least {LAG_LEAST_S:g} s",
        *_rotors(facts.rotors),
        "",
        f"[battery] # {'' if facts.cells else 'guess: '}{cells} lithium polymer cells in series",
        f"cells = {cells}",
        f"full_v = {_short(full_v)}",
        f"empty_v = {_short(empty_v)}",
        f"capacity_ah = {_short(BATTERY_WH_PER_KG * mass / mean_v)} "
        f"# guess: {BATTERY_WH_PER_KG:g} Wh a kg of the vehicle",
        *_limits(hover_share),
        *_gains(lag_s, arm_m),
        *_tolerances(arm_m, lag_s, gain_sigma),
    ]
    return "\n".join(blocks) + "\n"


def _check_room(facts: Facts) -> None:
    """Raise UsageError if two propellers overlap: most often the arm length is in another unit."""
    places = [rotor.position_m[:2] for rotor in facts.rotors]
    nearest = min(math.dist(a, b) for i, a in enumerate(places) for b in places[:i])
    if nearest < facts.propeller.diameter_m:
        raise UsageError(
            f"propellers of {facts.propeller.diameter_m:.3g} m overlap on hubs {nearest:.3g} m apart; "
            "check the arm length (m, centre to hub) and the propeller (inches)"
        )


def _by_mass(table: Sequence[tuple[float, float]], mass_kg: float) -> int | float:
    return next(value for below, value in table if mass_kg < below)


def _greatest_thrust(facts: Facts, cells: int | float) -> tuple[float, str, float]:
    """Return a rotor's greatest thrust, N, where it comes from, and one sigma of its relative error."""
    quarter_n = 0.25 * facts.mass_kg * GRAVITY
    if facts.thrust_max_n is not None:
        return facts.thrust_max_n, "given", _DATA_SHEET_SIGMA
    if facts.hover_share is not None:
        return quarter_n / facts.hover_share, "weight over the hover thrust of the parameter file", 0.05
    if facts.kv_rpm_v is None:
        ratio = _by_mass(THRUST_TO_WEIGHT, facts.mass_kg)
        return (
            ratio * quarter_n,
            f"guess: the rotors lift {ratio:g} times the weight; --thrust-max-n or --kv knows better",
            0.15,
        )
    a, b = THRUST_COEFFICIENT
    diameter_m = facts.propeller.diameter_m
    coefficient = a + b * facts.propeller.pitch_m / diameter_m
    turns = LOADED_SPEED * facts.kv_rpm_v * cells * CELL_V[1] / 60.0
    thrust_n = coefficient * AIR_DENSITY_KG_M3 * turns**2 * diameter_m**4
    return thrust_n, f"guess: C_T {coefficient:.3f} at {LOADED_SPEED:g} kv times the full voltage", 0.15


def _curve(diameter_m: float) -> float:
    """Return the quadratic part of the thrust curve for a diameter."""
    inches, parts = zip(*CURVE_BY_DIAMETER_IN, strict=True)
    return float(np.interp(diameter_m / _INCH_M, inches, parts))


def _head(facts: Facts) -> list[str]:
    d, p = (length / _INCH_M for length in (facts.propeller.diameter_m, facts.propeller.pitch_m))
    size = f"{d:.3g} x {p:.3g} in" if facts.propeller.known_pitch else f"{d:.3g} in (pitch guessed: {p:.2g})"
    motor = "" if facts.kv_rpm_v is None else f", {facts.kv_rpm_v:g} kv"
    arm = f"arms of {arm_length(facts.rotors):.4g} m"
    return [
        "Written by `trimtab vehicle new`. A guess is a typical value that nobody measured here.",
        "Replace guesses by measured values and lower their tolerances.",
        "`trimtab vehicle check LOG` compares this file with a flight.",
        f"Given: {facts.mass_kg:g} kg, {arm}, propellers of {size}{motor}.",
        *facts.sources,
        "Frames: body FRD, world NED; motor_command[i] drives rotors[i].",
    ]


def _rotors(rotors: Sequence[Rotor]) -> list[str]:
    lines = []
    for rotor in rotors:
        x, y, _ = rotor.position_m
        ends = ("front" if x > 1e-6 else "rear" if x < -1e-6 else "", _side(y))
        place = [round(value, 5) + 0.0 for value in rotor.position_m]
        lines += [
            "",
            f"[[rotors]] # {' '.join(word for word in ends if word)}",
            f"position_m = {place}",
            f'spin = "{rotor.spin}"',
        ]
    return lines


def _side(y: float) -> str:
    return "right" if y > 1e-6 else "left" if y < -1e-6 else ""


def _limits(hover_share: float) -> list[str]:
    """Return cautious limits, with a tilt at which the rotors carry the weight with a fifth to spare."""
    level = hover_share / (0.8 * HEADROOM[1])
    tilt = min(TILT_MOST_DEG, math.floor(math.degrees(math.acos(min(level, 1.0)))))
    limit, room = FIRST_LIMITS, FIRST_LIMITS["room_m"]
    rate, yaw_rate = limit["rate_rad_s"], limit["yaw_rate_rad_s"]
    return [
        "",
        "[limits] # for the first flights; set them for your room and your vehicle",
        f"speed_max_m_s = {limit['speed_m_s']}",
        f"tilt_max_deg = {float(max(tilt, 15.0))}",
        f"body_rate_max_rad_s = {[rate, rate, yaw_rate]}",
        f"jerk_max_m_s3 = {limit['jerk_m_s3']}",
        f"thrust_headroom = {list(HEADROOM)}",
        f"geofence_m = {[[-room, room], [-room, room], [-4.0, 0.3]]}",
    ]


def _gains(lag_s: float, arm_m: float) -> list[str]:
    """Return gains like those of the shipped vehicles, scaled with what the rotors' lag allows."""
    rate = 0.8 / lag_s
    k = rate / 30.0
    torque = 5.0 / arm_m
    rows = {
        "position_p": [10.0 * k * k, 10.0 * k * k, 16.0 * k * k],
        "velocity_d": [6.0 * k, 6.0 * k, 9.0 * k],
        "attitude_p": [12.0 * k, 12.0 * k, 5.0 * k],
        "rate_p": [rate, rate, 14.0 * k],
        "rate_i": [15.0 * k, 15.0 * k, 6.0 * k],
        "rate_d": [0.1, 0.1, 0.0],
        "rate_integral_limit": [torque, torque, 0.2 * torque],
    }
    lines = [f"{key} = {_list(values)}" for key, values in rows.items()]
    return ["", f"[gains] # for a motor lag of {lag_s:.3g} s", *lines, "rate_filter_hz = 40.0"]


def _tolerances(arm_m: float, lag_s: float, gain_sigma: float) -> list[str]:
    """Return the tolerances: how far each guess may be off, one sigma."""
    com_m = 0.01 * arm_m
    rows = {
        "com-offset.x": com_m,
        "com-offset.y": com_m,
        "inertia.x": 0.2,
        "inertia.y": 0.2,
        "inertia.z": 0.25,
        "linear-drag.dx": 0.1,
        "linear-drag.dy": 0.1,
        "linear-drag.dz": 0.1,
        "mass.factor": _WEIGHED_SIGMA,
        "motor-lag.extra_s": 0.2 * lag_s,
        "quadratic-drag.c": 0.01,
        "thrust-gain.gain": gain_sigma,
        "wind.wx": 0.1,
        "wind.wy": 0.1,
    }
    return [
        "",
        "[tolerances] # guesses, one sigma: tracing moves a value within them and names nothing",
        *(f'"{key}" = {_short(value)}' for key, value in rows.items()),
    ]


def _short(value: float) -> str:
    """Return a number with three significant digits, as TOML."""
    return repr(float(f"{value:.3g}"))


def _list(values: Sequence[float]) -> str:
    return "[" + ", ".join(_short(value) for value in values) + "]"
