"""Motion, thrusts, predicted residual and margins along a node table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trimtab.host.codegen import NUMPY
from trimtab.host.models.airframe import RATE, THETA, THRUST, P, V
from trimtab.host.plan.box import KEEP_OUT
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.plan.table import Table, evaluate, flat_states
from trimtab.host.route.shapes import Shape
from trimtab.host.vehicle import Limits, Vehicle
from trimtab.protocol.blobs import YawNode

_SAMPLE_US = 10_000


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Samples along a table.

    node: the node before each sample. x: as of `flat_states`. jerk_m_s3: norm. thrust_share: of a rotor's
    greatest thrust. residual: 3 or 6 rows, m/s^2, as of `ResidualModel.along`, acceleration NED and torque
    about the body axes; None without a model that predicts any. outside: whether the sample is outside the
    trained region, None where that is not known.
    """

    t_s: Annotated[np.ndarray, "samples"]
    node: Annotated[NDArray[np.int64], "samples"]
    x: Annotated[np.ndarray, "16 samples"]
    jerk_m_s3: Annotated[np.ndarray, "samples"]
    thrust_share: Annotated[np.ndarray, "4 samples"]
    residual: Annotated[np.ndarray, "_ samples"] | None
    outside: Annotated[NDArray[np.bool_], "samples"] | None

    @property
    def p_ned(self) -> Annotated[np.ndarray, "3 samples"]:
        """Positions, m."""
        return self.x[P]

    @property
    def speed_m_s(self) -> Annotated[np.ndarray, "samples"]:
        """Speeds."""
        return np.linalg.norm(self.x[V], axis=0)

    @property
    def rate_frd(self) -> Annotated[np.ndarray, "3 samples"]:
        """Body rates, rad/s."""
        return self.x[RATE]

    @property
    def tilt_deg(self) -> Annotated[np.ndarray, "samples"]:
        """Angles of the thrust from vertical."""
        roll, pitch, _ = self.x[THETA]
        return np.degrees(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0)))

    @property
    def residual_m_s2(self) -> Annotated[np.ndarray, "samples"] | None:
        """Norms of the residual, torque included."""
        return None if self.residual is None else np.linalg.norm(self.residual, axis=0)

    def margins(
        self, limits: Limits, keep_out: Sequence[Shape] = ()
    ) -> dict[str, Annotated[np.ndarray, "samples"]]:
        """Return the distances to each limit, negative beyond it, by the names of `law.checks`."""
        fence, rates = np.array(limits.geofence_m), np.array(limits.body_rate_max_rad_s)
        low, high = limits.thrust_headroom
        p = self.p_ned
        margins = {
            "geofence_m": np.minimum(p - fence[:, :1], fence[:, 1:] - p).min(axis=0),
            "floor_m": -p[2],
            "speed_m_s": limits.speed_max_m_s - self.speed_m_s,
            "tilt_deg": limits.tilt_max_deg - self.tilt_deg,
            "body_rate_rad_s": (rates[:, None] - np.abs(self.rate_frd)).min(axis=0),
            "jerk_m_s3": limits.jerk_max_m_s3 - self.jerk_m_s3,
            "thrust_low": self.thrust_share.min(axis=0) - low,
            "thrust_high": high - self.thrust_share.max(axis=0),
        }
        if keep_out:
            distances = [np.asarray(shape.signed_distance(NUMPY, list(p))) for shape in keep_out]
            margins[KEEP_OUT] = np.min(distances, axis=0)
        return margins

    def margin_shares(self, limits: Limits) -> dict[str, Annotated[np.ndarray, "samples"]]:
        """Return the distances to limits other than lengths, as shares: 0 at the limit, 1 far from it.

        thrust: to the nearer of its two limits, as a share of half the range between them.
        """
        rates = np.array(limits.body_rate_max_rad_s)
        low, high = limits.thrust_headroom
        nearest = np.minimum(self.thrust_share.min(axis=0) - low, high - self.thrust_share.max(axis=0))
        return {
            "speed": 1.0 - self.speed_m_s / limits.speed_max_m_s,
            "tilt": 1.0 - self.tilt_deg / limits.tilt_max_deg,
            "body rate": (1.0 - np.abs(self.rate_frd) / rates[:, None]).min(axis=0),
            "jerk": 1.0 - self.jerk_m_s3 / limits.jerk_max_m_s3,
            "thrust": nearest / (0.5 * (high - low)),
        }


def profile(
    vehicle: Vehicle,
    model: ResidualModel,
    table: Table,
    yaws: Sequence[YawNode],
    times_us: Annotated[np.ndarray, "samples"] | None = None,
) -> Profile:
    """Return the profile of the nominal vehicle at these times, every 10 ms by default."""
    at = sample_times(table) if times_us is None else times_us
    x = flat_states(vehicle, table, yaws, at)
    outside = None if model.region is None else model.region.outside(x.T, x[THRUST].sum(axis=0))
    node = np.searchsorted(table.times_us, at, side="right") - 1
    return Profile(
        t_s=at * 1e-6,
        node=np.clip(node, 0, len(table.times_us) - 1),
        x=x,
        jerk_m_s3=np.linalg.norm(evaluate(table, at)[3], axis=0),
        thrust_share=x[THRUST] / vehicle.thrust_max_n,
        residual=model.along(vehicle, x) if model.has_residual(vehicle) else None,
        outside=outside,
    )


def jerk_rms_m_s3(table: Table) -> float:
    """Return the RMS of the norm of the jerk at `sample_times`."""
    jerk = np.linalg.norm(evaluate(table, sample_times(table))[3], axis=0)
    return float(np.sqrt((jerk**2).mean()))


def sample_times(table: Table) -> Annotated[np.ndarray, "times"]:
    """Return evenly spaced times over the table, us, at most 10 ms apart."""
    end = float(table.times_us[-1])
    return np.linspace(0.0, end, max(2, int(np.ceil(end / _SAMPLE_US)) + 1))


def with_nodes(table: Table) -> Annotated[np.ndarray, "times"]:
    """Return `sample_times`, the nodes' times, and those just before them: thrust may jump at a node."""
    nodes = table.times_us.astype(float)
    return np.unique(np.concatenate([sample_times(table), nodes, nodes[1:] - 1.0]))
