"""A plant with the physics of RotorPy (Folk, Paulos, Kumar 2023), for `--plant`.

`Multirotor._s_dot_fn` of RotorPy is evaluated once with symbols, and the result is stepped. Its drag, inflow,
lift and lag are zero or nominal unless the world has them: linear drag across the discs is made at each hub
and grows with rotor speed (k_d), quadratic drag acts at the centre of mass (c_D), thrust inflow and
translational lift act at each hub (k_z, k_h), flapping is k_flap. Added are the loss of a rotor, linear drag
along z at the centre of mass, the rotors' gyroscopic torque, and a lag of its own for rotors that slow down.
RotorPy's frames are north-west-up and forward-left-up.
"""

# pyright: reportMissingImports=false
# RotorPy is of the extra `plants`.

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import FunctionType, SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from rotorpy.vehicles import multirotor

from trimtab.host.vehicle import Vehicle
from trimtab.sitl.draw import World
from trimtab.sitl.studies.plants.simulation import FULL_SPEED_RAD_S, Craft, SteppedPlant, flipped
from trimtab.sitl.vectors import Scalar, Vector, into_body, rotation


class _Multirotor(multirotor.Multirotor):
    """RotorPy's vehicle with a craft's parameters, and with what RotorPy lacks added to its wrench."""

    def __init__(self, craft: Craft) -> None:
        k_eta = craft.thrust_max_n / FULL_SPEED_RAD_S**2
        k_m = craft.torque_per_thrust_m * k_eta
        ixx, iyy, izz = craft.inertia_kg_m2
        arms = np.array([flipped(arm) for arm in craft.arms_frd])
        parameters = {
            "mass": craft.mass_kg,
            "Ixx": ixx,
            "Iyy": iyy,
            "Izz": izz,
            "Ixy": 0.0,
            "Ixz": 0.0,
            "Iyz": 0.0,
            "num_rotors": 4,
            "rotor_pos": {f"r{i}": arm for i, arm in enumerate(arms, start=1)},
            "rotor_directions": -np.array(craft.spins),  # of the torque on the body
            "rotor_speed_min": 0.0,
            "rotor_speed_max": FULL_SPEED_RAD_S,
            "k_eta": k_eta,
            "k_m": k_m,
            "k_h": 0.25 * craft.translational_lift,
            "k_z": 0.25 * craft.thrust_inflow / craft.hover_rad_s,
            **{f"c_D{axis}": craft.quadratic_drag for axis in "xyz"},
            "k_flap": -0.25 * craft.flapping / craft.hover_rad_s,
            "tau_m": craft.rise_s,
        }
        super().__init__(parameters)
        dx, dy, dz = craft.linear_drag
        for i, drag in enumerate((dx, dy)):  # RotorPy's k_d, apart for x and y
            self.rotor_drag_matrix[i, i] = 0.25 * drag / craft.hover_rad_s
        self._frame_drag = dz
        self._lost = k_eta * np.array(craft.rotor_loss)
        self._lost_torque = k_m * np.array(craft.rotor_loss) * self.rotor_dir
        self._momentum = craft.rotor_inertia_kg_m2 * np.array(craft.spins)
        self.outside = np.zeros((2, 3))
        """Force and torque from outside in FLU."""

    def compute_body_wrench(self, body_rates: Any, rotor_speeds: Any, body_airspeed_vector: Any) -> Any:
        """Return force and torque in FLU, with what RotorPy lacks: see the module."""
        force, torque = super().compute_body_wrench(body_rates, rotor_speeds, body_airspeed_vector)
        force, torque = np.array([force[i] for i in range(3)]), np.array([torque[i] for i in range(3)])
        lost = self._lost * rotor_speeds**2
        force[2] = force[2] - sum(lost) - self._frame_drag * body_airspeed_vector[2]
        x, y = self.rotor_geometry[:, 0], self.rotor_geometry[:, 1]
        spun = sum(self._momentum * rotor_speeds)
        p, q, _ = body_rates
        torque[0] = torque[0] - sum(y * lost) - q * spun
        torque[1] = torque[1] + sum(x * lost) + p * spun
        torque[2] = torque[2] - sum(self._lost_torque * rotor_speeds**2)
        return force + self.outside[0], torque + self.outside[1]


class _Equations:
    """`simulation.Equations` by RotorPy."""

    def __init__(self, craft: Craft) -> None:
        self._vehicle = _Multirotor(craft)
        self._lags_s = craft.rise_s, craft.fall_s

    def derivative(
        self,
        body: Mapping[str, Vector],
        target: Vector,
        wind_ned: Vector,
        force_ned: Vector,
        torque_frd: Vector,
    ) -> list[Scalar]:
        w, x, y, z = body["q_ned_frd"]
        speeds = [FULL_SPEED_RAD_S * n for n in body["speeds"]]
        state = _objects([
            *flipped(body["p_ned"]),
            *flipped(body["v_ned"]),
            x, -y, -z, w,
            *flipped(body["rate_frd"]),
            *flipped(wind_ned),
            *speeds,
        ])  # fmt: skip
        force_frd = into_body(rotation(body["q_ned_frd"]), force_ned)
        self._vehicle.outside = _objects([*flipped(force_frd), *flipped(torque_frd)]).reshape(2, 3)
        rise_s, fall_s = self._lags_s
        if rise_s != fall_s:
            pairs = zip(target, body["speeds"], strict=True)
            self._vehicle.tau_m = _objects([ca.if_else(new > old, rise_s, fall_s) for new, old in pairs])
        s = _derivative(self._vehicle, 0.0, state, FULL_SPEED_RAD_S * _objects(target))
        x, y, z, w = s[6:10]
        speeds = s[16:20] / FULL_SPEED_RAD_S
        return [*flipped(s[0:3]), *flipped(s[3:6]), w, x, -y, -z, *flipped(s[10:13]), *speeds]


class RotorPyPlant(SteppedPlant):
    """The plant; see `SteppedPlant` for its arguments."""

    def __init__(
        self, vehicle: Vehicle, options: Mapping[str, Any], seed: int, world: World | None = None
    ) -> None:
        super().__init__("rotorpy", _Equations, vehicle, options, seed, world)


def _objects(values: Sequence[Scalar]) -> np.ndarray:
    """Return scalars as an array of objects."""
    array = np.empty(len(values), dtype=object)
    array[:] = list(values)
    return array


class _Symbolic:
    """NumPy, as RotorPy uses it, with zeros that can become symbols."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    @staticmethod
    def zeros(shape: Any) -> np.ndarray:
        """Return zeros that are objects."""
        return np.zeros(shape, dtype=object)


def _from_quat(q: Vector) -> Any:
    """Return what RotorPy uses of SciPy's rotation, which takes numbers only."""
    x, y, z, w = q
    matrix = _objects(rotation([w, x, y, z])).reshape(3, 3)
    return SimpleNamespace(as_matrix=lambda: matrix)


_derivative = FunctionType(
    multirotor.Multirotor._s_dot_fn.__code__,
    {**vars(multirotor), "np": _Symbolic(), "Rotation": SimpleNamespace(from_quat=_from_quat)},
)
"""RotorPy's derivative of the state, in an environment whose NumPy and rotations take symbols."""
