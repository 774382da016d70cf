"""The content of a vehicle file, as a frozen type with the keys of the file.

Frames: body FRD, world NED. Rotor i of the file is driven by motor_command[i]. A rotor's thrust is
T / thrust_max_n = c1 u + c2 u^2 at full battery; its reaction torque about +z_frd is +torque_per_thrust_m T
for a rotor that turns counter-clockwise seen from above, minus that for a clockwise one.
"""

from __future__ import annotations

import hashlib
import unicodedata
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.vehicle.canonical_toml import write_toml
from trimtab.host.vehicle.strict_toml import Strict, number, validate, value_at

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Positive3 = tuple[Positive, Positive, Positive]
NonNegative3 = tuple[NonNegative, NonNegative, NonNegative]
Vector3 = tuple[float, float, float]
_NAME_LENGTH = 40


def check_name(name: str) -> str:
    """Return the name of a vehicle or route itself. Raises ValueError if it cannot be one.

    Letters and digits of all alphabets are allowed, with the marks on them.
    """
    known = (each.isalnum() or each in "-_" or unicodedata.category(each) in ("Mn", "Mc") for each in name)
    if not (0 < len(name) <= _NAME_LENGTH and name[0].isalnum() and all(known)):
        raise ValueError(
            f"{name!r}: a name has letters, digits, - and _, begins with a letter or digit, and has at most "
            f"{_NAME_LENGTH} characters; choose another one"
        )
    return name


Name = Annotated[str, AfterValidator(check_name)]


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    """Return the interval itself. Raises ValueError unless low is below high."""
    if not interval[0] < interval[1]:
        raise ValueError(f"{list(interval)} is not an interval; give [low, high] with low below high")
    return interval


Interval = Annotated[tuple[float, float], AfterValidator(_ordered)]


def _above_floor(fence: tuple[Interval, Interval, Interval]) -> tuple[Interval, Interval, Interval]:
    """Return the geofence itself. Raises ValueError if all of it lies below the floor."""
    low, high = fence[2]
    if low >= 0.0:
        raise ValueError(
            f"down from {low:g} to {high:g} m lies below the floor; up is negative, "
            f"write [{-high:g}, {0.0 - low:g}] for {low:g} to {high:g} m up"
        )
    return fence


Geofence = Annotated[tuple[Interval, Interval, Interval], AfterValidator(_above_floor)]
"""[low, high] of north, east and down; up is negative down."""

SPIN_SIGN = {"ccw": 1, "cw": -1}
"""Sign of a rotor's reaction torque about +z_frd."""


class Rotor(Strict):
    """One rotor: its position and direction of rotation."""

    position_m: Vector3
    """From the centre of mass, FRD."""
    spin: Literal["cw", "ccw"]
    """Seen from above."""

    @property
    def spin_sign(self) -> int:
        """+1 for ccw, -1 for cw: the sign of the reaction torque about +z_frd."""
        return SPIN_SIGN[self.spin]


class Battery(Strict):
    """The battery's cells and its voltage range."""

    cells: Annotated[int, Field(ge=1, le=24)]
    full_v: Positive
    empty_v: Positive
    capacity_ah: Positive

    @field_validator("empty_v")
    @classmethod
    def _below_full(cls, value: float, info: ValidationInfo) -> float:
        full_v = info.data.get("full_v")  # None if it is invalid itself
        if full_v is not None and not value < full_v:
            raise ValueError(f"{value:g} is not below full_v {full_v:g}; correct one of them")
        return value


class Limits(Strict):
    """Bounds on every plan. The vehicle checks the same limits on board."""

    speed_max_m_s: Positive
    tilt_max_deg: Annotated[float, Field(gt=0.0, le=85.0)]
    body_rate_max_rad_s: Positive3
    """Roll, pitch and yaw rate, FRD."""
    jerk_max_m_s3: Positive
    thrust_headroom: Interval
    """Lowest and highest share of thrust_max_n that a plan may use of any rotor."""
    geofence_m: Geofence

    @field_validator("thrust_headroom")
    @classmethod
    def _within_range(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] < 0.0 or value[1] > 1.0:
            raise ValueError(f"{list(value)} is not within 0..1; give shares of thrust_max_n")
        return value


class Gains(Strict):
    """Gains of the on-board control law. Body axes are FRD; positions and velocities are NED."""

    position_p: NonNegative3
    """1/s^2."""
    velocity_d: NonNegative3
    """1/s."""
    attitude_p: NonNegative3
    """1/s."""
    rate_p: NonNegative3
    """1/s."""
    rate_i: NonNegative3
    """1/s^2."""
    rate_d: NonNegative3
    """Gain of the derivative of the filtered body rate; dimensionless."""
    rate_integral_limit: NonNegative3
    """Greatest angular acceleration from the rate integral, rad/s^2."""
    rate_filter_hz: Positive
    """Corner frequency of the first-order filter on the body rate."""
    observer: NonNegative | None = None
    """Bandwidth of the disturbance observer, 1/s. Without it, the observer is off."""


class Sensors(Strict):
    """What the vehicle measures beside gyro, accelerometer and battery."""

    rotor_speed: bool
    """Whether the motor controllers report rotor speeds, sent as FC_ROTORS."""


def _read_only(mapping: Mapping[str, float]) -> Mapping[str, float]:
    """Return a read-only copy of the mapping."""
    return MappingProxyType(dict(mapping))


ToleranceKey = Annotated[str, Field(pattern=r"^[a-z][a-z0-9]*(-[a-z0-9]+)*(\.[a-z][a-z0-9_]*)?$")]


class Vehicle(Strict):
    """A quadrotor. Immutable, hashable and picklable; `id` is the hash of its content."""

    name: Name
    mass_kg: Positive
    inertia_kg_m2: Positive3
    """Diagonal about x, y, z of FRD."""
    thrust_max_n: Positive
    """Of one rotor, at full battery."""
    thrust_curve: tuple[NonNegative, NonNegative]
    torque_per_thrust_m: Positive
    motor_lag_s: Positive
    rotors: tuple[Rotor, Rotor, Rotor, Rotor]
    battery: Battery
    limits: Limits
    gains: Gains
    tolerances: Annotated[Mapping[ToleranceKey, Positive], AfterValidator(_read_only)]
    """One standard deviation of what is not worth naming, by "effect.parameter" or "effect"."""
    sensors: Sensors | None = None

    @field_validator("inertia_kg_m2")
    @classmethod
    def _inertia_of_a_body(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if 2.0 * max(value) > sum(value) * (1.0 + 1e-9):
            raise ValueError(
                f"{list(value)} is not possible for a rigid body; no axis may exceed the sum of the other two"
            )
        return value

    @field_validator("thrust_curve")
    @classmethod
    def _curve_reaches_one(cls, value: tuple[float, float]) -> tuple[float, float]:
        if abs(sum(value) - 1.0) > 1e-9:
            raise ValueError(f"c1 + c2 is {sum(value):g}; scale them to a sum of 1")
        return value

    @field_validator("rotors")
    @classmethod
    def _rotors_span_all_axes(cls, value: tuple[Rotor, ...]) -> tuple[Rotor, ...]:
        # The 4 x 4 allocation matrix is singular exactly if some combination of rotor thrusts has no effect.
        rows = [[1.0, -r.position_m[1], r.position_m[0], float(r.spin_sign)] for r in value]
        size = max(abs(entry) for row in rows for entry in row[1:3]) or 1.0
        scaled = [[row[0], row[1] / size, row[2] / size, row[3]] for row in rows]
        if abs(_determinant(scaled)) < 1e-6:
            raise ValueError("these rotors cannot turn the vehicle about all axes; check positions and spins")
        return value

    @model_validator(mode="after")
    def _can_hover(self) -> Self:
        if problem := hover_problem(self.model_dump(exclude={"tolerances"})):
            raise ValueError(problem)
        return self

    @cached_property
    def id(self) -> str:
        """First 12 hex digits of the SHA-256 of the canonical text."""
        return hashlib.sha256(self.to_toml().encode()).hexdigest()[:12]

    @property
    def measures_rotor_speed(self) -> bool:
        """Whether the vehicle reports its rotor speeds."""
        return self.sensors is not None and self.sensors.rotor_speed

    @property
    def id_bytes(self) -> bytes:
        """The id as the 6 bytes that blobs and messages carry."""
        return bytes.fromhex(self.id)

    def tolerance(self, effect: str, parameter: str, default: float) -> float:
        """Return the tolerance of `effect.parameter`: its own entry, else the effect's, else `default`."""
        return self.tolerances.get(f"{effect}.{parameter}", self.tolerances.get(effect, default))

    def replace(self, **changes: Any) -> Vehicle:
        """Return a vehicle with these fields changed, checked like a file. Raises ConfigurationError."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return validate({**fields, **changes}, self.name, Vehicle)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with these fields changed, unchecked; see `replace`."""
        copy = super().model_copy(update=update, deep=deep)
        vars(copy).pop("id", None)  # it is cached
        return copy

    def to_toml(self) -> str:
        """Return the canonical TOML text. The same vehicle gives the same bytes, and reads back equal."""
        return write_toml(self)

    def __hash__(self) -> int:
        return hash(self.id)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the function and arguments that rebuild the vehicle, for pickle."""
        data = {**self.model_dump(exclude={"tolerances"}), "tolerances": dict(self.tolerances)}
        return validate, (data, self.name, Vehicle)


def hover_problem(data: Mapping[str, Any]) -> str | None:
    """Return why the vehicle cannot hover, or None if it can or if a number is missing or invalid."""
    mass_kg = number(value_at(data, ("mass_kg",)))
    thrust_max_n = number(value_at(data, ("thrust_max_n",)))
    share = number(value_at(data, ("limits", "thrust_headroom", 1)))
    if mass_kg is None or thrust_max_n is None or share is None:
        return None
    ceiling, weight = 4.0 * thrust_max_n * share, mass_kg * GRAVITY
    if not 0.0 < ceiling <= weight:
        return None
    return (
        f"cannot hover: the rotors give at most {ceiling:.3g} N in total, the weight is {weight:.3g} N; "
        "raise thrust_max_n or limits.thrust_headroom, or lower mass_kg"
    )


def _determinant(matrix: list[list[float]]) -> float:
    """Return the determinant by expansion along the first row."""
    if len(matrix) == 1:
        return matrix[0][0]
    total = 0.0
    for column, entry in enumerate(matrix[0]):
        minor = [row[:column] + row[column + 1 :] for row in matrix[1:]]
        total += (-1) ** column * entry * _determinant(minor)
    return total
