"""Sensitivity of the predicted residual to deviations from the reference, at each node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from trimtab.firmware_model.law.rotations import euler_rates
from trimtab.host.codegen import CASADI, held_interrupts
from trimtab.host.models.airframe import STATE_SIZE, THETA, V
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.table import Table, flat_states
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import YawNode

Array = NDArray[np.float64]


class Peak(NamedTuple):
    """A greatest value, with its node and time."""

    value: float
    node: int
    t_s: float


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Greatest singular values of the residual's slopes at the nodes of a reference.

    velocity: of d(residual)/d(v_ned), m/s^2 per m/s. attitude: of d(residual)/d(a small rotation of the
    vehicle), m/s^2 per rad. Each is the largest change of the residual per unit of a small deviation,
    with rotor thrusts constant. NaN where an effect has no slope, as a root may have none at rest.
    """

    t_s: Annotated[np.ndarray, "nodes"]
    velocity: Annotated[np.ndarray, "nodes"]
    attitude: Annotated[np.ndarray, "nodes"]

    def peaks(self) -> tuple[Peak, Peak] | None:
        """Return the greatest of velocity and of attitude; None where an effect has no slope at any node."""
        if not (np.isfinite(self.velocity).any() and np.isfinite(self.attitude).any()):
            return None
        v, a = int(np.nanargmax(self.velocity)), int(np.nanargmax(self.attitude))
        return (
            Peak(value=float(self.velocity[v]), node=v, t_s=float(self.t_s[v])),
            Peak(value=float(self.attitude[a]), node=a, t_s=float(self.t_s[a])),
        )

    def to_json(self) -> dict[str, dict[str, float | int]] | None:
        """Return the peaks as plain data."""
        peaks = self.peaks()
        if peaks is None:
            return None
        v, a = peaks
        return {
            "velocity": {"greatest_per_s": v.value, "node": v.node, "t_s": v.t_s},
            "attitude": {"greatest_m_s2_per_rad": a.value, "node": a.node, "t_s": a.t_s},
        }


def sensitivity(
    vehicle: Vehicle, model: ResidualModel, table: Table, yaws: Sequence[YawNode]
) -> Sensitivity | None:
    """Return the sensitivity along a reference, by exact derivatives; None without a predicted residual."""
    if not model.has_residual(vehicle):
        return None
    x = flat_states(vehicle, table, yaws, table.times_us)
    n = x.shape[1]
    slopes = np.array(_slopes(vehicle, model).map(n)(x)).reshape(-1, n, 6).transpose(1, 0, 2)
    return Sensitivity(
        t_s=table.times_us.astype(float) * 1e-6,
        velocity=_greatest(slopes[:, :, :3]),
        attitude=_greatest(slopes[:, :, 3:]),
    )


def _greatest(slopes: Array) -> Array:
    """Return the greatest singular values (n,) of (n, rows, 3), NaN where an entry is not finite."""
    out, known = np.full(len(slopes), np.nan), np.isfinite(slopes).all(axis=(1, 2))
    out[known] = np.linalg.norm(slopes[known], 2, axis=(1, 2))
    return out


@held_interrupts()
def _slopes(vehicle: Vehicle, model: ResidualModel) -> ca.Function:
    """Return the function x (16) -> (3 or 6, 6) d(residual)/d(v_ned, rotation vector in FRD)."""
    x, turn = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("turn", 3)
    residual = ca.vertcat(*model.rows(CASADI, vehicle, ca.vertsplit(x)))
    if model.network is not None:
        inputs = ca.vertcat(x[V], x[THETA])
        residual[:3] += model.network.layout.matrices(ca.SX(model.network.xi), inputs)
    # A small rotation changes the Euler angles as an equal body rate does in unit time.
    angles = ca.vertcat(*euler_rates(CASADI, ca.vertsplit(x[THETA]), ca.vertsplit(turn)))
    slope = ca.jacobian(residual, x)
    both = ca.horzcat(slope[:, V], slope[:, THETA] @ ca.jacobian(angles, turn))
    return ca.Function("slopes", [x], [ca.densify(both)])
