"""A plant with the physics of crazyflow (learnsyslab), its model from first principles, for `--plant`.

crazyflow's symbolic dynamics are stepped. Its own drag, lag and rotor inertia are zero or nominal unless the
world has them: linear drag acts at the centre of mass (drag_matrix), a rotor's inertia gives a gyroscopic
torque and one against its acceleration (prop_inertia). Speeds of rotors are in revolutions per minute, frames
north-west-up and forward-left-up.
"""

# pyright: reportMissingImports=false
# crazyflow is of the extra `plants`.

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from typing import Any

import casadi as ca
import numpy as np

from trimtab.host.vehicle import Vehicle
from trimtab.sitl.draw import World
from trimtab.sitl.studies.plants.simulation import FULL_SPEED_RAD_S, Craft, SteppedPlant, flipped
from trimtab.sitl.surroundings import GRAVITY_M_S2
from trimtab.sitl.vectors import Scalar, Vector, add, cross, dot, into_body, into_world, rotation


def _load() -> Any:
    """Return crazyflow's symbolic dynamics.

    crazyflow refuses to be imported after SciPy unless the environment asks for SciPy's array API, and it
    prints which of its renderers are missing. Other processes must not inherit the former.
    """
    before = os.environ.get(_ARRAY_API)
    os.environ[_ARRAY_API] = "1"
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            from crazyflow.dynamics.first_principles import symbolic_dynamics
    finally:
        del os.environ[_ARRAY_API]
        if before is not None:
            os.environ[_ARRAY_API] = before
    return symbolic_dynamics


_ARRAY_API = "SCIPY_ARRAY_API"
_symbolic_dynamics = _load()

_FULL_RPM = FULL_SPEED_RAD_S * 60.0 / (2.0 * math.pi)


class _Equations:
    """`simulation.Equations` by crazyflow."""

    def __init__(self, craft: Craft) -> None:
        thrust = craft.thrust_max_n * (1.0 - np.array(craft.rotor_loss)) / _FULL_RPM**2
        torque = craft.torque_per_thrust_m * thrust
        zero = np.zeros(4)
        arms = np.array([flipped(arm) for arm in craft.arms_frd])
        inertia = np.diag(craft.inertia_kg_m2)
        derivative, state, command, _ = _symbolic_dynamics(
            model_dist_f=True,
            model_dist_t=True,
            mass=craft.mass_kg,
            L=1.0,  # the arms are in the matrix
            prop_inertia=craft.rotor_inertia_kg_m2,
            gravity_vec=np.array([0.0, 0.0, -GRAVITY_M_S2]),
            J=inertia,
            J_inv=np.linalg.inv(inertia),
            rpm2thrust=np.stack([zero, zero, thrust], axis=-1),
            rpm2torque=np.stack([zero, zero, torque], axis=-1),
            mixing_matrix=np.stack([arms[:, 1], -arms[:, 0], -np.array(craft.spins)]),
            drag_matrix=-np.diag(craft.linear_drag),
            rotor_dyn_coef=np.array([[1.0 / craft.rise_s, 0.0, 1.0 / craft.fall_s, 0.0]]),
        )
        self._derivative = ca.Function("crazyflow", [state, command], [derivative]).expand()
        self._craft = craft

    def derivative(
        self,
        body: Mapping[str, Vector],
        target: Vector,
        wind_ned: Vector,
        force_ned: Vector,
        torque_frd: Vector,
    ) -> list[Scalar]:
        w, x, y, z = body["q_ned_frd"]
        R = rotation(body["q_ned_frd"])
        flow_ned = [v - u for v, u in zip(body["v_ned"], wind_ned, strict=True)]
        more_force, more_torque = self._more(body, into_body(R, flow_ned))
        state = [
            *flipped(body["p_ned"]),
            x, -y, -z, w,
            *flipped(flow_ned),  # crazyflow knows no wind
            *flipped(body["rate_frd"]),
            *(_FULL_RPM * n for n in body["speeds"]),
            *flipped(add(force_ned, into_world(R, more_force))),
            *flipped(into_world(R, add(torque_frd, more_torque))),
        ]  # fmt: skip
        s = ca.vertsplit(self._derivative(ca.vertcat(*state), ca.vertcat(*(_FULL_RPM * n for n in target))))
        x, y, z, w = s[3:7]
        speeds = [n / _FULL_RPM for n in s[13:17]]
        return [*body["v_ned"], *flipped(s[7:10]), w, x, -y, -z, *flipped(s[10:13]), *speeds]

    def _more(self, body: Mapping[str, Vector], flow: Vector) -> tuple[list[Scalar], list[Scalar]]:
        """Return force and torque, FRD, of the aerodynamics that crazyflow lacks: all but linear drag.

        flow: velocity of the centre of mass through the air, FRD.
        """
        craft = self._craft
        speed = ca.sqrt(dot(flow, flow))
        force: list[Scalar] = [-craft.quadratic_drag * speed * u for u in flow]
        torque: list[Scalar] = [0.0, 0.0, 0.0]
        for arm, n in zip(craft.arms_frd.tolist(), body["speeds"], strict=True):
            hub = add(flow, cross(body["rate_frd"], arm))
            inflow = craft.thrust_inflow * n * FULL_SPEED_RAD_S / craft.hover_rad_s * hub[2]
            lift = craft.translational_lift * (hub[0] * hub[0] + hub[1] * hub[1])
            up = [0.0, 0.0, -0.25 * (inflow + lift)]
            force, torque = add(force, up), add(torque, cross(arm, up))
        return force, torque


class CrazyflowPlant(SteppedPlant):
    """The plant; see `SteppedPlant` for its arguments."""

    def __init__(
        self, vehicle: Vehicle, options: Mapping[str, Any], seed: int, world: World | None = None
    ) -> None:
        super().__init__("crazyflow", _Equations, vehicle, options, seed, world)
