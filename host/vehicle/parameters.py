"""The one mapping from a vehicle file to the parameters on board."""

from __future__ import annotations

from collections.abc import Iterator

from host.vehicle.model import Vehicle
from host.vehicle.strict_toml import ConfigurationError
from protocol.parameters import BY_NAME, complete

THRUST_MIN_SHARE = 1.0 / 170.0
"""Least thrust of an armed rotor, of thrust_max_n, so that it keeps turning; 0.05 N for the research quad."""


def to_parameters(vehicle: Vehicle) -> dict[str, float]:
    """A value for every parameter of protocol's table, as float32: the vehicle's, defaults for the rest.

    Raises ConfigurationError naming the keys whose values the table does not allow.
    """
    problems = parameter_problems(vehicle)
    if problems:
        raise ConfigurationError([f"{vehicle.name}: {problem}" for problem in problems])
    return complete({name: value for name, _, value in _mapping(vehicle)})


def parameter_problems(vehicle: Vehicle) -> list[str]:
    """One line, `key.path: what, remedy`, for each value that the vehicle cannot hold on board."""
    problems = []
    for name, key, value in _mapping(vehicle):
        try:
            BY_NAME[name].check(value)
        except ValueError as error:
            problems.append(f"{key}: cannot be set on board, {error}; change it")
    return problems


def _mapping(vehicle: Vehicle) -> Iterator[tuple[str, str, float]]:
    """(parameter, key path in the vehicle file, value) of everything that a vehicle file decides."""
    yield "MASS", "mass_kg", vehicle.mass_kg
    yield from _axes("INERTIA", "XYZ", "inertia_kg_m2", vehicle.inertia_kg_m2)
    for k, rotor in enumerate(vehicle.rotors):
        yield f"ROTOR{k + 1}_X", f"rotors[{k}].position_m[0]", rotor.position_m[0]
        yield f"ROTOR{k + 1}_Y", f"rotors[{k}].position_m[1]", rotor.position_m[1]
        yield f"ROTOR{k + 1}_SPIN", f"rotors[{k}].spin", float(rotor.spin_sign)
    yield "TORQUE_PER_N", "torque_per_thrust_m", vehicle.torque_per_thrust_m
    yield "THRUST_MAX", "thrust_max_n", vehicle.thrust_max_n
    yield "THRUST_C1", "thrust_curve[0]", vehicle.thrust_curve[0]
    yield "THRUST_C2", "thrust_curve[1]", vehicle.thrust_curve[1]
    yield "THRUST_MIN", "thrust_max_n", vehicle.thrust_max_n * THRUST_MIN_SHARE

    gains = vehicle.gains
    yield from _axes("POS_P", "NED", "gains.position_p", gains.position_p)
    yield from _axes("VEL_D", "NED", "gains.velocity_d", gains.velocity_d)
    yield from _axes("ATT_P", "XYZ", "gains.attitude_p", gains.attitude_p)
    yield from _axes("RATE_P", "XYZ", "gains.rate_p", gains.rate_p)
    yield from _axes("RATE_I", "XYZ", "gains.rate_i", gains.rate_i)
    yield from _axes("RATE_D", "XYZ", "gains.rate_d", gains.rate_d)
    yield from _axes("RATE_ILIM", "XYZ", "gains.rate_integral_limit", gains.rate_integral_limit)
    yield "RATE_FILT_HZ", "gains.rate_filter_hz", gains.rate_filter_hz

    limits = vehicle.limits
    yield "LIM_SPEED", "limits.speed_max_m_s", limits.speed_max_m_s
    yield "LIM_TILT_DEG", "limits.tilt_max_deg", limits.tilt_max_deg
    yield from _axes("LIM_RATE", "XYZ", "limits.body_rate_max_rad_s", limits.body_rate_max_rad_s)
    yield "LIM_JERK", "limits.jerk_max_m_s3", limits.jerk_max_m_s3
    yield "LIM_THR_LO", "limits.thrust_headroom[0]", limits.thrust_headroom[0]
    yield "LIM_THR_HI", "limits.thrust_headroom[1]", limits.thrust_headroom[1]
    for k, (axis, (low, high)) in enumerate(zip("NED", limits.geofence_m, strict=True)):
        yield f"FENCE_{axis}_MIN", f"limits.geofence_m[{k}][0]", low
        yield f"FENCE_{axis}_MAX", f"limits.geofence_m[{k}][1]", high


def _axes(
    stem: str, axes: str, key: str, values: tuple[float, float, float]
) -> Iterator[tuple[str, str, float]]:
    """One row an axis."""
    for k, (axis, value) in enumerate(zip(axes, values, strict=True)):
        yield f"{stem}_{axis}", f"{key}[{k}]", value
