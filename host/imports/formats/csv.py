"""Reader of CSV flight logs with a TOML file that gives the meaning, unit and frame of each column."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from trimtab.host.imports.contents import Contents
from trimtab.host.imports.formats.nanobench import STANDARD_GRAVITY
from trimtab.host.imports.formats.table import header, table, table_contents
from trimtab.host.imports.frames import (
    Body,
    World,
    q_ned_frd,
    to_frd,
    to_ned,
    turn_from_euler,
    turn_from_quaternion,
)
from trimtab.host.imports.recording import (
    ImportFormatError,
    Recording,
    Unknown,
    first_of_equal,
    fresh,
    since_first_us,
)
from trimtab.host.vehicle import ConfigurationError
from trimtab.host.vehicle.files import read_text
from trimtab.host.vehicle.strict_toml import Strict, parse_toml, validate

Three = tuple[str, str, str]
Four = tuple[str, str, str, str]

_TIME_US = {"s": 1e6, "ms": 1e3, "us": 1.0}


class ColumnMap(Strict):
    """Columns of a CSV flight log, by name. SI and radians unless a unit key says otherwise."""

    world: World
    """Axes of positions: north-east-down, north-west-up or east-north-up."""
    body: Body
    """Axes of rates, forces and torques, and of the body in the attitude."""
    time: str
    time_unit: Literal["s", "ms", "us"] = "s"
    position_m: Three
    quaternion: Four | None = None
    """Body to world."""
    quaternion_order: Literal["wxyz", "xyzw"] = "wxyz"
    euler: Three | None = None
    """Roll, pitch and yaw columns, ZYX, of the body axes in the world axes named above."""
    euler_unit: Literal["rad", "deg"] = "rad"
    motor_command: Four | None = None
    """Motor commands in the order of the vehicle file's rotors."""
    motor_command_full: Annotated[float, Field(gt=0.0)] = 1.0
    """Value of a full motor command."""
    motor_command_zero: float = 0.0
    """Value of no motor command, as 1000 for pulses of 1000 to 2000 us."""
    thrust_n: str | None = None
    """Commanded collective thrust."""
    torque_n_m: Three | None = None
    """Commanded torque. Without it, the torque is unknown and the measured body rate is used instead."""
    gyro: Three | None = None
    gyro_unit: Literal["rad/s", "deg/s"] = "rad/s"
    specific_force: Three | None = None
    """Specific force, as an accelerometer measures it: it points up at rest."""
    specific_force_unit: Literal["m/s2", "g"] = "m/s2"
    battery_v: str | None = None
    reference_position_m: Three | None = None
    """Reference that the vehicle followed."""
    reference_velocity_m_s: Three | None = None
    reference_acceleration_m_s2: Three | None = None
    unknown: tuple[Unknown, ...] = ()
    """Properties that the log does not determine; tracing estimates them as nuisance."""


def read_map(path: Path | str) -> ColumnMap:
    """Return the column map in a TOML file. Raises ConfigurationError (exit code 2) with every problem."""
    path = Path(path)
    data = parse_toml(read_text(path), path.name)
    problems = [f"{path.name}: {problem}" for problem in _contradictions(data)]
    try:
        columns = validate(data, path.name, ColumnMap)
    except ConfigurationError as error:
        raise ConfigurationError([*error.problems, *problems]) from None
    if problems:
        raise ConfigurationError(problems)
    if columns.thrust_n is not None and columns.torque_n_m is None and "torque" not in columns.unknown:
        return columns.model_copy(update={"unknown": (*columns.unknown, "torque")})
    return columns


def _contradictions(data: Mapping[str, Any]) -> list[str]:
    """Return one line for each contradiction between the keys of a column map."""
    keys = set(data)
    problems = []
    if ("quaternion" in keys) == ("euler" in keys):
        problems.append("attitude: give either quaternion or euler")
    if {"motor_command", "thrust_n"} <= keys:
        problems.append("inputs: give either motor_command or thrust_n")
    if "torque_n_m" in keys and "thrust_n" not in keys:
        problems.append("torque_n_m: has no meaning without thrust_n; add thrust_n")
    for unit, owner in (
        ("quaternion_order", "quaternion"),
        ("euler_unit", "euler"),
        ("motor_command_full", "motor_command"),
        ("motor_command_zero", "motor_command"),
        ("gyro_unit", "gyro"),
        ("specific_force_unit", "specific_force"),
        ("reference_velocity_m_s", "reference_position_m"),
        ("reference_acceleration_m_s2", "reference_position_m"),
    ):
        if unit in keys and owner not in keys:
            problems.append(f"{unit}: has no meaning without {owner}; add {owner} or remove {unit}")
    zero, full = data.get("motor_command_zero", 0.0), data.get("motor_command_full", 1.0)
    numbers = all(isinstance(value, int | float) for value in (zero, full))
    if "motor_command_zero" in keys and numbers and not zero < full:
        problems.append(f"motor_command_zero: {zero:g} is not below motor_command_full, {full:g}")
    for key, names in data.items():
        if key != "unknown" and isinstance(names, list) and len(set(map(str, names))) < len(names):
            problems.append(f"{key}: names a column twice; give a different column for each entry")
    return problems


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the first line names at least two columns."""
    return bool(header(head))


def contents(path: Path) -> Contents:
    """Return the columns of the file, of unknown rate without a column map. Raises ImportFormatError."""
    return table_contents(path)


def read(path: Path | str, columns: Path | str) -> Recording:
    """Return the flight of a CSV file, read with a column map.

    Raises ConfigurationError for the map (exit code 2) and ImportFormatError for the log.
    """
    path, chosen = Path(path), read_map(columns)
    groups = (
        (chosen.time,), chosen.position_m, chosen.quaternion, chosen.euler, chosen.motor_command,
        chosen.torque_n_m, chosen.gyro, chosen.specific_force, chosen.reference_position_m,
        chosen.reference_velocity_m_s, chosen.reference_acceleration_m_s2,
        tuple(name for name in (chosen.thrust_n, chosen.battery_v) if name is not None),
    )  # fmt: skip
    held = table(path, [name for group in groups for name in group or ()])
    rows = held.columns
    t_us = since_first_us(rows[chosen.time], _TIME_US[chosen.time_unit], path.name)
    keep = first_of_equal(t_us)
    t_us = t_us[keep]

    def stack(names: tuple[str, ...]) -> np.ndarray:
        return np.column_stack([rows[name][keep] for name in names])

    def in_world(names: Three | None) -> np.ndarray | None:
        return None if names is None else to_ned(stack(names), chosen.world)

    def in_body(names: Three | None, scale: float = 1.0) -> np.ndarray | None:
        return None if names is None else to_frd(stack(names), chosen.body) * scale

    def alone(name: str | None) -> np.ndarray | None:
        return None if name is None else rows[name][keep]

    def times_of(*columns: object) -> np.ndarray | None:
        return t_us if any(item is not None for item in columns) else None

    position = stack(chosen.position_m)
    attitude, turn = _turn(chosen, stack, path.name)
    new = fresh(position, attitude)
    zero, full = chosen.motor_command_zero, chosen.motor_command_full
    motors = None if chosen.motor_command is None else (stack(chosen.motor_command) - zero) / (full - zero)
    return Recording(
        source=path.name,
        pose_us=t_us[new],
        p_ned=to_ned(position, chosen.world)[new],
        q_ned_frd=q_ned_frd(turn, chosen.world, chosen.body)[new],
        input_us=times_of(motors, chosen.thrust_n),
        motor_command=motors,
        thrust_n=alone(chosen.thrust_n),
        torque_n_m=in_body(chosen.torque_n_m),
        imu_us=times_of(chosen.gyro, chosen.specific_force),
        gyro=in_body(chosen.gyro, np.pi / 180.0 if chosen.gyro_unit == "deg/s" else 1.0),
        specific_force=in_body(
            chosen.specific_force, STANDARD_GRAVITY if chosen.specific_force_unit == "g" else 1.0
        ),
        battery_us=times_of(chosen.battery_v),
        battery_v=alone(chosen.battery_v),
        reference_us=times_of(chosen.reference_position_m),
        p_ref_ned=in_world(chosen.reference_position_m),
        v_ref_ned=in_world(chosen.reference_velocity_m_s),
        a_ref_ned=in_world(chosen.reference_acceleration_m_s2),
        unknown=chosen.unknown,
        skipped_rows=held.skipped,
        epoch_us=round(_TIME_US[chosen.time_unit] * float(rows[chosen.time][0])),
    )


def _turn(chosen: ColumnMap, stack: Any, source: str) -> tuple[np.ndarray, Rotation]:
    """Return the attitude as in the file, (n, 4) or (n, 3), and as rotations from body to world axes."""
    if chosen.euler is not None:
        angles = stack(chosen.euler)
        return angles, turn_from_euler(angles, degrees=chosen.euler_unit == "deg")
    assert chosen.quaternion is not None
    q = stack(chosen.quaternion)
    try:
        return q, turn_from_quaternion(q, scalar_first=chosen.quaternion_order == "wxyz")
    except ValueError as error:
        raise ImportFormatError(f"{source}: {error}; remove or correct that row") from None
