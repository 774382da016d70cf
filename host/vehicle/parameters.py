"""Mapping from a vehicle file to the parameters on board."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from trimtab.host.vehicle.model import SPIN_SIGN, Vehicle
from trimtab.host.vehicle.strict_toml import ConfigurationError, key_path, number, value_at
from trimtab.protocol.parameters import BY_NAME, complete

THRUST_MIN_SHARE = 1.0 / 170.0
"""Minimum thrust of an armed rotor over thrust_max_n, so that it keeps turning; 0.05 N for `research`."""


def to_parameters(vehicle: Vehicle) -> dict[str, float]:
    """Return a float32 value for every parameter of the protocol's table: the vehicle's, or the default.

    Raises ConfigurationError with the keys whose values the table does not allow.
    """
    data = vehicle.model_dump(exclude={"tolerances"})
    problems = parameter_problems(data)
    if problems:
        raise ConfigurationError([f"{vehicle.name}: {key}: {problem}" for key, problem in problems])
    return complete({name: value for name, _, value in _mapping(data)})


def parameter_problems(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return (key path, problem and remedy) for each value that the firmware does not accept.

    Values that are missing or of another type are left out; the validation of the vehicle reports those.
    """
    problems = []
    for name, key, value in _mapping(data):
        try:
            BY_NAME[name].check(value)
        except ValueError as error:
            problems.append((key, f"the firmware does not accept it: {error}; change it"))
    return problems


def _mapping(data: Mapping[str, Any]) -> Iterator[tuple[str, str, float]]:
    """Yield (parameter, key path in the vehicle file, value) for every parameter that a vehicle file sets."""
    for name, path in _locations():
        entry = value_at(data, path)
        value = number(SPIN_SIGN.get(str(entry)) if path[-1] == "spin" else entry)
        if value is not None:
            scale = THRUST_MIN_SHARE if name == "THRUST_MIN" else 1.0
            yield name, key_path(path, data), value * scale


def _locations() -> Iterator[tuple[str, tuple[str | int, ...]]]:
    """Yield each parameter and the location of its value in the vehicle file."""
    yield "MASS", ("mass_kg",)
    yield from _axes("INERTIA", "XYZ", "inertia_kg_m2")
    for k in range(4):
        yield f"ROTOR{k + 1}_X", ("rotors", k, "position_m", 0)
        yield f"ROTOR{k + 1}_Y", ("rotors", k, "position_m", 1)
        yield f"ROTOR{k + 1}_SPIN", ("rotors", k, "spin")
    yield "TORQUE_PER_N", ("torque_per_thrust_m",)
    yield "THRUST_MAX", ("thrust_max_n",)
    yield "THRUST_C1", ("thrust_curve", 0)
    yield "THRUST_C2", ("thrust_curve", 1)
    yield "THRUST_MIN", ("thrust_max_n",)
    yield "MOTOR_LAG", ("motor_lag_s",)
    yield "BAT_CELLS", ("battery", "cells")
    yield "BAT_FULL_V", ("battery", "full_v")
    yield "BAT_EMPTY_V", ("battery", "empty_v")

    yield from _axes("POS_P", "NED", "gains", "position_p")
    yield from _axes("VEL_D", "NED", "gains", "velocity_d")
    yield from _axes("ATT_P", "XYZ", "gains", "attitude_p")
    yield from _axes("RATE_P", "XYZ", "gains", "rate_p")
    yield from _axes("RATE_I", "XYZ", "gains", "rate_i")
    yield from _axes("RATE_D", "XYZ", "gains", "rate_d")
    yield from _axes("RATE_ILIM", "XYZ", "gains", "rate_integral_limit")
    yield "RATE_FILT_HZ", ("gains", "rate_filter_hz")
    yield "OBS_GAIN", ("gains", "observer")

    yield "LIM_SPEED", ("limits", "speed_max_m_s")
    yield "LIM_TILT_DEG", ("limits", "tilt_max_deg")
    yield from _axes("LIM_RATE", "XYZ", "limits", "body_rate_max_rad_s")
    yield "LIM_JERK", ("limits", "jerk_max_m_s3")
    yield "LIM_THR_LO", ("limits", "thrust_headroom", 0)
    yield "LIM_THR_HI", ("limits", "thrust_headroom", 1)
    for k, axis in enumerate("NED"):
        yield f"FENCE_{axis}_MIN", ("limits", "geofence_m", k, 0)
        yield f"FENCE_{axis}_MAX", ("limits", "geofence_m", k, 1)


def _axes(stem: str, axes: str, *path: str) -> Iterator[tuple[str, tuple[str | int, ...]]]:
    """Yield one row for each axis."""
    for k, axis in enumerate(axes):
        yield f"{stem}_{axis}", (*path, k)
