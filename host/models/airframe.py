"""The rigid body's state, and what the models read of a vehicle and its effects.

State x, 16 scalars: p_ned 3, v_ned 3, Theta 3 (roll, pitch, yaw), rate_frd 3, rotor thrust 4 (N, nominal,
before any thrust factor).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from trimtab.host.effects import Effect

Scalar = Any
Part = tuple[Effect, Sequence[Scalar]]
"""An effect and its parameter values."""

STATE_SIZE = 16
P, V, THETA, RATE, THRUST = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 16)


class Rotor(Protocol):
    """One rotor: its position and its sense of rotation seen from above."""

    @property
    def position_m(self) -> Sequence[float]: ...
    @property
    def spin(self) -> str: ...


class Airframe(Protocol):
    """The entries of a vehicle file that the model uses."""

    @property
    def mass_kg(self) -> float: ...
    @property
    def inertia_kg_m2(self) -> Sequence[float]: ...
    @property
    def rotors(self) -> Sequence[Rotor]: ...
    @property
    def thrust_max_n(self) -> float: ...
    @property
    def thrust_curve(self) -> Sequence[float]: ...
    @property
    def torque_per_thrust_m(self) -> float: ...
    @property
    def motor_lag_s(self) -> float: ...
