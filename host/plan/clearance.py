"""Clearance of a plan: the distance that gates and keep-out shapes need because no flight is exact.

A vehicle leaves its reference by the error that the model predicts, and by what the model lacks. A plan keeps
their sum, its clearance, from every edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from trimtab.host.plan.profile import profile
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.table import from_reference
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference

ALLOWANCE_M = 0.1
"""What a plan allows for errors that its model does not predict, unless stated."""


def predicted_error_ned(
    vehicle: Vehicle, model: ResidualModel, reference: Reference
) -> Annotated[np.ndarray, "samples 3"]:
    """Return the tracking error, m, that a model predicts along a reference, every 10 ms.

    It answers the residual acceleration by the position loop of the flatness-based law, as
    `trimtab.host.plan.tracking_error` says. It starts at zero.
    """
    along = profile(vehicle, model, from_reference(reference), reference.yaw_nodes())
    error = np.zeros((len(along.t_s), 3))
    if along.residual is None:
        return error
    step_s = float(along.t_s[1] - along.t_s[0])
    for axis, (k_p, k_v) in enumerate(zip(vehicle.gains.position_p, vehicle.gains.velocity_d, strict=True)):
        error[:, axis] = _driven(k_p, k_v, step_s, along.residual[axis])
    return error


def _driven(k_p: float, k_v: float, step_s: float, d: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return e of e'' = d - k_p e - k_v e' from rest, exact for d that is constant over each step."""
    from scipy.linalg import expm  # slow to import, and not needed without a model

    both = expm(step_s * np.array([[0.0, 1.0, 0.0], [-k_p, -k_v, 1.0], [0.0, 0.0, 0.0]]))
    state, out = np.zeros(2), np.zeros(len(d))
    for k, value in enumerate(d[:-1]):
        state = both[:2, :2] @ state + both[:2, 2] * value
        out[k + 1] = state[0]
    return out


def predicted_error_max_m(vehicle: Vehicle, model: ResidualModel, reference: Reference) -> float:
    """Return the largest tracking error that a model predicts along a reference, m."""
    return float(np.linalg.norm(predicted_error_ned(vehicle, model, reference), axis=1).max())
