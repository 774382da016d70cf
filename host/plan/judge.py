"""The verdict on a node table, by the vehicle's own checks on its rounded reference, and figures along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.law.checks import Verdict, check_reference, from_parameters
from host.codegen import NUMPY
from host.models.dynamics import THETA, THRUST, P, V, residual_acceleration_ned
from host.plan.box import KEEP_OUT, checked
from host.plan.dynamics import ResidualModel
from host.plan.table import Table, evaluate, flat_states, from_reference, to_reference
from host.route.shapes import Shape
from host.vehicle import Limits, Vehicle, to_parameters
from protocol.blobs import Reference, YawNode

Array = NDArray[np.float64]

_SAMPLE_US = 10_000


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A reference, the table as it is flown, and whether it may be. margins: least distance to each limit."""

    reference: Reference
    table: Table
    ok: bool
    message: str
    verdict: Verdict
    margins: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Along the whole reference. residual_rms_m_s2: None without a model. outside_region: share of it beyond
    the region that the model's data covers, None where that is not known.
    """

    path_length_m: float
    mean_speed_m_s: float
    residual_rms_m_s2: float | None
    outside_region: float | None


def judge(
    table: Table, yaws: Sequence[YawNode], vehicle: Vehicle, limits: Limits, keep_out: Sequence[Shape]
) -> Judged:
    """The verdict on a table as the vehicle will read it, within these limits and those on board."""
    reference = to_reference(table, yaws, vehicle.id)
    airframe, on_board = from_parameters(to_parameters(vehicle))
    verdict = check_reference(
        reference.nodes,
        reference.yaw_nodes(),
        airframe,
        checked(limits, on_board),
        origin=reference.origin_ned,
    )
    flown = from_reference(reference)
    margins, ok, message = dict(verdict.margins), verdict.ok, verdict.message
    if keep_out:
        margins[KEEP_OUT], where = _keep_out(flown, keep_out)
        if margins[KEEP_OUT] < 0.0:
            ok, message = False, where if verdict.ok else message
    return Judged(reference=reference, table=flown, ok=ok, message=message, verdict=verdict, margins=margins)


def measure(vehicle: Vehicle, model: ResidualModel, table: Table, yaws: Sequence[YawNode]) -> Figures:
    """Length, speed and predicted residual along a table, sampled every 10 ms."""
    times_us = _samples(table)
    x = flat_states(vehicle, table, yaws, times_us)
    length = float(np.linalg.norm(np.diff(x[P], axis=1), axis=0).sum())
    rms: float | None = None
    if model.has_residual:
        rms = float(np.sqrt((_residual(vehicle, model, x) ** 2).sum(axis=0).mean()))
    duration_s = float(table.times_us[-1]) * 1e-6
    beyond: float | None = None
    if model.region is not None:
        beyond = float(model.region.outside(x.T, x[THRUST].sum(axis=0)).mean())
    return Figures(
        path_length_m=length,
        mean_speed_m_s=length / duration_s,
        residual_rms_m_s2=rms,
        outside_region=beyond,
    )


def residual_along(vehicle: Vehicle, model: ResidualModel, reference: Reference) -> Array:
    """(3, n) the predicted residual acceleration, NED, m/s^2, every 10 ms along a reference."""
    table = from_reference(reference)
    return _residual(vehicle, model, flat_states(vehicle, table, reference.yaw_nodes(), _samples(table)))


def _residual(vehicle: Vehicle, model: ResidualModel, x: Array) -> Array:
    """(3, n) at states (16, n)."""
    rows = residual_acceleration_ned(NUMPY, vehicle, model.parts, list(x))
    d = np.array([np.broadcast_to(row, x.shape[1:]) for row in rows])
    return d if model.network is None else d + model.network.acceleration_ned(x[V], x[THETA])


def _samples(table: Table) -> NDArray[np.float64]:
    end = float(table.times_us[-1])
    return np.linspace(0.0, end, max(2, int(np.ceil(end / _SAMPLE_US)) + 1))


def _keep_out(table: Table, shapes: Sequence[Shape]) -> tuple[float, str]:
    """Least distance from the shapes, and a sentence on where that is."""
    times_us = _samples(table)
    p = evaluate(table, times_us)[0]
    least, where = np.inf, ""
    for number, shape in enumerate(shapes):
        distance = np.asarray(shape.signed_distance(NUMPY, list(p)))
        k = int(distance.argmin())
        if distance[k] < least:
            least = float(distance[k])
            node = int(np.searchsorted(table.times_us, times_us[k], side="right")) - 1
            where = (
                f"node {node} at {table.times_us[node] * 1e-6:.3f} s: {-least:.3g} m inside "
                f"keep_out[{number}] ({shape.kind}), at {times_us[k] * 1e-6:.3f} s"
            )
    return least, where
