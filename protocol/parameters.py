"""The parameter table: every parameter on board with type, default, unit and bounds.

Every parameter is a float32 on board. Whole numbers travel as int32. Names have at most 16 characters. The
defaults describe the 0.752 kg research quadrotor. In a name, X, Y, Z are axes of the body frame FRD; N, E, D
are axes of the world frame NED.

Values are compared after rounding to float32 (`equal`): 0.1 on the host equals 0.10000000149 on board.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

NAME_MAX = 16
_FLOAT = struct.Struct("<f")


def float32(value: float) -> float:
    """Return `value` rounded to the nearest float32. Raises ValueError if the result is not finite."""
    try:
        rounded = _FLOAT.unpack(_FLOAT.pack(value))[0]
    except OverflowError:
        raise ValueError(f"{value!r} is beyond float32") from None
    if not math.isfinite(rounded):
        raise ValueError(f"{value!r} is not a finite number")
    return rounded


def equal(a: float, b: float) -> bool:
    """Return whether two values are equal on board, that is after rounding to float32."""
    return float32(a) == float32(b)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One row of the table. The bounds are inclusive; `unit` is empty for a pure number.

    `integer`: whether it is a whole number of magnitude below 2^24, which travels as an int32.
    """

    name: str
    default: float
    unit: str
    min: float
    max: float
    description: str
    integer: bool = False

    def __post_init__(self) -> None:
        if not 0 < len(self.name) <= NAME_MAX or not self.name.isascii():
            raise ValueError(f"parameter name {self.name!r} must have 1 to {NAME_MAX} ASCII characters")
        if not self.min <= self.default <= self.max:
            raise ValueError(f"{self.name}: default {self.default} outside {self.min}..{self.max}")

    def check(self, value: float) -> float:
        """Return `value` as float32. Raises ValueError if it is out of bounds or not a whole number."""
        try:
            rounded = float32(value)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
        if not (self.min <= value <= self.max or float32(self.min) <= rounded <= float32(self.max)):
            bounds = f"{self.min:g}..{self.max:g} {self.unit}".rstrip()
            raise ValueError(f"{self.name}: {value:g} is outside {bounds}")
        if self.integer and not rounded.is_integer():
            raise ValueError(f"{self.name}: {value:g} is not a whole number")
        return rounded


def _row(
    name: str, default: float, unit: str, low: float, high: float, description: str, *, integer: bool = False
) -> Parameter:
    return Parameter(
        name=name, default=default, unit=unit, min=low, max=high, description=description, integer=integer
    )


def _axes(
    stem: str, axes: str, defaults: tuple[float, ...], unit: str, low: float, high: float, description: str
) -> Iterator[Parameter]:
    for axis, default in zip(axes, defaults, strict=True):
        yield _row(f"{stem}_{axis}", default, unit, low, high, f"{description}, {axis.lower()} axis")


def _rotors() -> Iterator[Parameter]:
    arm = 0.088
    places = ((arm, arm, 1.0), (-arm, -arm, 1.0), (arm, -arm, -1.0), (-arm, arm, -1.0))
    for number, (x, y, spin) in enumerate(places, start=1):
        yield _row(f"ROTOR{number}_X", x, "m", -2.0, 2.0, f"rotor {number}, forward of the centre of mass")
        yield _row(f"ROTOR{number}_Y", y, "m", -2.0, 2.0, f"rotor {number}, right of the centre of mass")
        text = f"rotor {number} seen from above: 1 counter-clockwise, -1 clockwise"
        yield _row(f"ROTOR{number}_SPIN", spin, "", -1.0, 1.0, text)


PARAMETERS: tuple[Parameter, ...] = (
    # The vehicle.
    _row("MASS", 0.752, "kg", 0.01, 50.0, "mass"),
    *_axes("INERTIA", "XYZ", (2.5e-3, 2.1e-3, 4.3e-3), "kg m^2", 1e-7, 10.0, "moment of inertia"),
    *_rotors(),
    _row("TORQUE_PER_N", 0.022, "m", 1e-5, 1.0, "reaction torque of a rotor over its thrust"),
    _row("THRUST_MAX", 8.5, "N", 1e-3, 500.0, "thrust of one rotor at full command and full battery"),
    _row("THRUST_C1", 0.0, "", 0.0, 1.0, "linear part of the thrust curve T/T_max = c1 u + c2 u^2"),
    _row("THRUST_C2", 1.0, "", 0.0, 1.0, "quadratic part of the thrust curve"),
    _row("THRUST_MIN", 0.05, "N", 0.0, 50.0, "least thrust of a rotor while armed"),
    _row("BAT_CELLS", 4, "", 1, 24, "battery cells in series", integer=True),
    _row("BAT_FULL_V", 16.8, "V", 0.5, 120.0, "voltage of the full battery"),
    _row("BAT_EMPTY_V", 13.2, "V", 0.5, 120.0, "voltage of the empty battery"),
    # The law.
    *_axes("POS_P", "NED", (6.0, 6.0, 10.0), "1/s^2", 0.0, 100.0, "gain of the position error"),
    *_axes("VEL_D", "NED", (4.0, 4.0, 6.0), "1/s", 0.0, 50.0, "gain of the velocity error"),
    *_axes("ATT_P", "XYZ", (8.0, 8.0, 3.0), "1/s", 0.0, 100.0, "gain of the attitude error"),
    *_axes("RATE_P", "XYZ", (18.0, 18.0, 8.0), "1/s", 0.0, 500.0, "gain of the body rate error"),
    *_axes("RATE_I", "XYZ", (5.0, 5.0, 1.0), "1/s^2", 0.0, 500.0, "gain of the body rate error's integral"),
    *_axes("RATE_D", "XYZ", (0.25, 0.25, 0.0), "", 0.0, 20.0, "gain of the body rate's derivative"),
    *_axes("RATE_ILIM", "XYZ", (8.0, 8.0, 2.0), "rad/s^2", 0.0, 1000.0, "bound of the rate integral"),
    _row("RATE_FILT_HZ", 40.0, "Hz", 1.0, 300.0, "corner of the body rate filter of the derivative"),
    _row("THRUST_FLOOR", 0.2, "", 0.0, 1.0, "least commanded collective thrust, share of the weight"),
    # The estimator: continuous gains.
    _row("EST_POS", 20.0, "1/s", 0.0, 500.0, "gain from a pose's position error to position"),
    _row("EST_VEL", 120.0, "1/s^2", 0.0, 5000.0, "gain from a pose's position error to velocity"),
    _row("EST_ATT", 5.0, "1/s", 0.0, 500.0, "gain from a pose's attitude error to attitude"),
    _row("EST_BIAS", 0.5, "1/s^2", 0.0, 50.0, "gain from a pose's attitude error to the gyro bias"),
    _row("EST_BIAS_MAX", 0.2, "rad/s", 0.0, 2.0, "bound of the estimated gyro bias"),
    # The disturbance observer.
    _row("OBS_GAIN", 0.0, "1/s", 0.0, 20.0, "bandwidth of the disturbance observer, 0 for off"),
    _row("MOTOR_LAG", 0.033, "s", 1e-4, 1.0, "time constant of the rotors' thrust"),
    # Limits of the on-board check.
    _row("LIM_SPEED", 10.0, "m/s", 0.1, 100.0, "greatest speed of a reference"),
    _row("LIM_TILT_DEG", 60.0, "deg", 1.0, 180.0, "greatest tilt of a reference"),
    *_axes("LIM_RATE", "XYZ", (6.0, 6.0, 3.0), "rad/s", 0.1, 100.0, "greatest body rate of a reference"),
    _row("LIM_JERK", 80.0, "m/s^3", 0.1, 10000.0, "greatest jerk of a reference"),
    _row("LIM_THR_LO", 0.08, "", 0.0, 1.0, "least rotor thrust on a reference, share of THRUST_MAX"),
    _row("LIM_THR_HI", 0.65, "", 0.0, 1.0, "greatest rotor thrust on a reference, share of THRUST_MAX"),
    _row("FENCE_N_MIN", -10.0, "m", -10000.0, 10000.0, "southern wall of the flight volume"),
    _row("FENCE_N_MAX", 10.0, "m", -10000.0, 10000.0, "northern wall of the flight volume"),
    _row("FENCE_E_MIN", -10.0, "m", -10000.0, 10000.0, "western wall of the flight volume"),
    _row("FENCE_E_MAX", 10.0, "m", -10000.0, 10000.0, "eastern wall of the flight volume"),
    _row("FENCE_D_MIN", -6.0, "m", -10000.0, 10000.0, "ceiling of the flight volume, down is positive"),
    _row("FENCE_D_MAX", 0.3, "m", -10000.0, 10000.0, "bottom of the flight volume, down is positive"),
    _row("END_HEIGHT", 0.5, "m", 0.0, 100.0, "least height at which a reference starts and ends"),
    # The flight around a reference.
    _row("TAKEOFF_SPEED", 1.0, "m/s", 0.05, 10.0, "greatest speed of the climb to the first node"),
    _row(
        "TAKEOFF_CLEAR",
        0.3,
        "m",
        0.0,
        100.0,
        "horizontal distance of the first node above which the climb starts vertically",
    ),
    _row("TAKEOFF_HEIGHT", 1.0, "m", 0.3, 100.0, "default height of a takeoff"),
    _row("HOVER_S", 1.0, "s", 0.0, 60.0, "hover before tracking"),
    _row("HOLD_S", 1.0, "s", 0.0, 600.0, "hold after the last node"),
    _row("LAND_SPEED", 0.5, "m/s", 0.05, 5.0, "speed of the descent"),
    _row("LAND_DECEL", 4.0, "m/s^2", 0.1, 50.0, "greatest deceleration to a stop before an early landing"),
    _row("LAND_HEIGHT", 0.25, "m", 0.05, 10.0, "height below which a descent that stopped has landed"),
    _row("LAND_STOP_SPEED", 0.15, "m/s", 0.01, 5.0, "speed below which a descent has stopped"),
    _row("IDLE_S", 30.0, "s", 1.0, 3600.0, "time armed on the floor after which the vehicle disarms"),
    _row("OFFB_ACCEL", 4.0, "m/s^2", 0.1, 50.0, "greatest acceleration towards a setpoint"),
    _row("OFFB_TURN", 1.5, "rad/s", 0.05, 20.0, "greatest yaw rate towards a setpoint's yaw"),
    _row("OFFB_HEIGHT", 0.2, "m", 0.0, 100.0, "least height above the floor of a setpoint"),
    # Arming.
    _row("ARM_TILT_DEG", 20.0, "deg", 1.0, 90.0, "greatest tilt at arming"),
    _row(
        "ARM_ASKEW_DEG",
        10.0,
        "deg",
        0.5,
        90.0,
        "greatest angle at arming between the verticals of accelerometer and poses",
    ),
    _row("ARM_GYRO_STILL", 0.15, "rad/s", 0.001, 5.0, "greatest change of a gyro sample during calibration"),
    _row(
        "OWN_OTHERS",
        2,
        "",
        0,
        2,
        "what a station other than the owner may do in flight: 0 nothing, 1 land, 2 land and terminate",
        integer=True,
    ),
    _row("SIGN_REQUIRED", 0, "", 0, 1, "1: arming needs a key of message signing", integer=True),
    # Rejection of poses in flight.
    _row("EST_JUMP_M", 0.5, "m", 0.01, 100.0, "distance from the estimate beyond which a pose is refused"),
    _row("EST_JUMP_SPEED", 3.0, "m/s", 0.0, 100.0, "growth of EST_JUMP_M with the age of the last pose"),
    _row(
        "EST_CLASH",
        8,
        "",
        0,
        1000,
        "rejected poses among accepted ones, within 0.25 s, after which no pose is used; 0 for never",
        integer=True,
    ),
    _row("EST_JUMP_DEG", 45.0, "deg", 1.0, 180.0, "angle from the estimate beyond which a pose is refused"),
    # The place of the local frame's origin on the globe, of which the vehicle itself makes no use.
    _row("ORIGIN_LAT_DEG", 47, "deg", -85, 85, "latitude of the origin, rounded down", integer=True),
    _row("ORIGIN_LAT_E7", 3977420, "1e-7 deg", 0, 9999999, "rest of the latitude", integer=True),
    _row("ORIGIN_LON_DEG", 8, "deg", -180, 179, "longitude of the origin, rounded down", integer=True),
    _row("ORIGIN_LON_E7", 5455940, "1e-7 deg", 0, 9999999, "rest of the longitude", integer=True),
    _row("ORIGIN_ALT", 488.0, "m", -500.0, 9000.0, "altitude of the origin above mean sea level"),
    # Failsafes.
    _row("FS_TILT_DEG", 85.0, "deg", 10.0, 180.0, "tilt that counts as loss of control"),
    _row("FS_TILT_S", 0.3, "s", 0.001, 60.0, "time beyond FS_TILT_DEG before the motors stop"),
    _row("FS_MOCAP_S", 0.5, "s", 0.01, 60.0, "time without a pose before the vehicle descends level"),
    _row("FS_LINK_S", 3.0, "s", 0.1, 3600.0, "time without a host message before the vehicle lands"),
    _row("FS_AGE_S", 0.1, "s", 0.01, 10.0, "age of the newest pose above which poses are late"),
    _row("FS_LATE_S", 1.0, "s", 0.01, 60.0, "time with late poses before the vehicle lands"),
    _row("FS_OFFB_S", 0.5, "s", 0.05, 60.0, "time without a setpoint before the vehicle holds"),
    _row("FS_OFFB_HOLD_S", 10.0, "s", 0.0, 3600.0, "hold after the last setpoint before the vehicle lands"),
    _row("FS_BAT_SHARE", 0.1, "", 0.0, 1.0, "low battery, share from empty to full voltage, 0 for off"),
    _row("FS_BAT_S", 3.0, "s", 0.1, 600.0, "time constant of the voltage filter"),
    _row("FS_SAT_S", 1.5, "s", 0.05, 60.0, "time with saturated motors before the vehicle lands"),
    _row("FS_IMU_S", 0.05, "s", 0.0, 60.0, "time with an unchanging IMU before the motors stop, 0 for off"),
    _row(
        "FS_LOOP_MAX", 100, "", 1, 10000, "late ticks within FS_LOOP_S before the vehicle lands", integer=True
    ),
    _row("FS_LOOP_S", 1.0, "s", 0.01, 600.0, "time over which late ticks are counted"),
    _row("FS_FENCE_M", 0.5, "m", 0.0, 1000.0, "distance beyond the flight volume that counts as leaving it"),
    _row("FS_FENCE_S", 0.5, "s", 0.0, 60.0, "time beyond FS_FENCE_M before the vehicle lands"),
    _row("FS_SINK_SPEED", 0.7, "m/s", 0.05, 5.0, "speed of the level descent near the floor"),
    _row("FS_BLIND_S", 12.0, "s", 0.5, 60.0, "time that the level descent follows dead-reckoned velocity"),
    _row("FS_BLIND_END_S", 3.0, "s", 2.0, 60.0, "time after FS_BLIND_S at which the level descent ends"),
)


def _index(table: tuple[Parameter, ...]) -> Mapping[str, Parameter]:
    names = {row.name: row for row in table}
    if len(names) != len(table):
        raise ValueError("duplicate parameter name")
    return MappingProxyType(names)


BY_NAME: Mapping[str, Parameter] = _index(PARAMETERS)
"""Rows of the table by name."""

INDEX: Mapping[str, int] = MappingProxyType({row.name: index for index, row in enumerate(PARAMETERS)})
"""Index of each name in the table: param_index of PARAM_VALUE."""

ORIGIN = frozenset({"ORIGIN_LAT_DEG", "ORIGIN_LAT_E7", "ORIGIN_LON_DEG", "ORIGIN_LON_E7", "ORIGIN_ALT"})
"""Names of the parameters that place the local frame on the globe."""

DEFAULTS: Mapping[str, float] = MappingProxyType({row.name: row.default for row in PARAMETERS})
"""Default of each parameter, in the order of the table."""


def complete(values: Mapping[str, float]) -> dict[str, float]:
    """Return `values` completed with defaults, rounded to float32, in the order of the table.

    Raises ValueError if a name is not in the table or a value is not allowed.
    """
    unknown = sorted(set(values) - set(BY_NAME))
    if unknown:
        raise ValueError(f"no such parameter: {', '.join(unknown)}")
    return {row.name: row.check(values.get(row.name, row.default)) for row in PARAMETERS}


def differences(
    expected: Mapping[str, float], on_board: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Return (expected, on board) of each parameter of `expected` that differs after rounding to float32.

    The value on board is NaN if `on_board` lacks the parameter. The place of the origin is left out: it is
    the user's, and no flight depends on it.
    """
    pairs = {}
    for name, value in expected.items():
        if name in ORIGIN:
            continue
        board_value = on_board.get(name, math.nan)
        if math.isnan(board_value) or not equal(value, board_value):
            pairs[name] = (value, board_value)
    return pairs
