"""The bounds that a plan is solved in: just inside the limits, tighter where the reference exceeds them.

Limits are judged on the final reference, within every interval; the solver sees only its nodes. If the
reference exceeds a limit, the solver's bound is tightened by the excess before the next round.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

from trimtab.firmware_model.law.feedforward import REGION_MARGIN
from trimtab.firmware_model.law.limits import Limits as CheckedLimits
from trimtab.host.models.region import Region
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.vehicle import Limits

_INSET = 0.01  # share of a limit that the first box leaves unused, except for
_INSET_RATE = 0.05
_INSET_THRUST = 0.02
_EXCESS = 1.2  # multiple of an excess that a bound is tightened by,
_STEP = 0.002  # plus this share of the bound
KEEP_OUT = "keep_out_m"
GATES = "gates_m"
OBSTACLES = (KEEP_OUT, GATES)
YAW_RATE = "yaw_rate_rad_s"
"""Names of the margins to keep-out shapes, to the edges of gates and to the greatest rate of a free heading.

`trimtab.firmware_model.law.checks` names the others.
"""


@dataclass(frozen=True, kw_only=True)
class SolverBox:
    """Bounds at the nodes.

    thrust_share: of thrust_max_n, low and high. fence_m: least distance inside the geofence. floor_m: least
    height. keep_out_m: least distance from keep-out shapes. yaw_rate_rad_s: of a free heading, infinite where
    the heading is given.
    """

    thrust_share: tuple[float, float]
    body_rate_rad_s: tuple[float, float, float]
    tilt_deg: float
    speed_m_s: float
    jerk_m_s3: float
    fence_m: float
    floor_m: float
    keep_out_m: float
    yaw_rate_rad_s: float

    @classmethod
    def inside(cls, limits: Limits, yaw_rate_max_rad_s: float | None = None) -> SolverBox:
        """Return a box just inside the limits, and inside the greatest rate of a free heading."""
        low, high = limits.thrust_headroom
        inset = _INSET_THRUST * (high - low)
        x, y, z = (bound * (1.0 - _INSET_RATE) for bound in limits.body_rate_max_rad_s)
        return cls(
            thrust_share=(low + inset, high - inset),
            body_rate_rad_s=(x, y, z),
            tilt_deg=limits.tilt_max_deg * (1.0 - _INSET),
            speed_m_s=limits.speed_max_m_s * (1.0 - _INSET),
            jerk_m_s3=limits.jerk_max_m_s3 * (1.0 - _INSET),
            fence_m=0.01,
            floor_m=-math.inf,
            keep_out_m=0.03,
            yaw_rate_rad_s=(1.0 - _INSET) * (math.inf if yaw_rate_max_rad_s is None else yaw_rate_max_rad_s),
        )

    def excess(self, margins: Mapping[str, float]) -> float:
        """Return the largest negative margin as a share of its limit; metres count as they are."""
        low, high = self.thrust_share
        scale = {
            "thrust_low": high - low,
            "thrust_high": high - low,
            "body_rate_rad_s": max(self.body_rate_rad_s),
            "tilt_deg": self.tilt_deg,
            "speed_m_s": self.speed_m_s,
            "jerk_m_s3": self.jerk_m_s3,
            YAW_RATE: self.yaw_rate_rad_s,
        }
        return max((-margin / scale.get(name, 1.0) for name, margin in margins.items()), default=0.0)

    def tightened(self, margins: Mapping[str, float]) -> SolverBox:
        """Return the box tightened by the reference's negative margins, and a little more."""

        def excess(name: str, bound: float, most: float) -> float:
            margin = margins.get(name, 0.0)
            return min(most, _EXCESS * -margin + _STEP * bound) if margin < 0.0 else 0.0

        def lower(name: str, bound: float) -> float:
            return bound - excess(name, bound, 0.3 * bound)

        low, high = self.thrust_share
        sunk = excess("floor_m", 1.0, 0.3)
        x, y, z = (lower("body_rate_rad_s", bound) for bound in self.body_rate_rad_s)
        return SolverBox(
            thrust_share=(
                low + excess("thrust_low", high - low, 0.1 * (high - low)),
                high - excess("thrust_high", high - low, 0.1 * (high - low)),
            ),
            body_rate_rad_s=(x, y, z),
            tilt_deg=lower("tilt_deg", self.tilt_deg),
            speed_m_s=lower("speed_m_s", self.speed_m_s),
            jerk_m_s3=lower("jerk_m_s3", self.jerk_m_s3),
            fence_m=self.fence_m + excess("geofence_m", 1.0, 0.3),
            floor_m=max(self.floor_m + sunk, 0.0) if sunk > 0.0 else self.floor_m,
            keep_out_m=self.keep_out_m + excess(KEEP_OUT, 1.0, 0.3),
            yaw_rate_rad_s=lower(YAW_RATE, self.yaw_rate_rad_s),
        )


def within_region(limits: Limits, region: Region, dynamics: Dynamics) -> Limits:
    """Return the limits within a trained region, extended by a tenth; thrust in equal shares."""
    low, high = limits.thrust_headroom
    most = REGION_MARGIN * region.thrust_max_n / (4.0 * dynamics.vehicle.thrust_max_n)
    least = region.thrust_min_n / (REGION_MARGIN * 4.0 * dynamics.vehicle.thrust_max_n)
    hover = dynamics.hover_n / dynamics.vehicle.thrust_max_n
    return limits.model_copy(
        update={
            "speed_max_m_s": min(limits.speed_max_m_s, REGION_MARGIN * region.speed_max_m_s),
            "tilt_max_deg": min(limits.tilt_max_deg, max(5.0, REGION_MARGIN * region.tilt_max_deg)),
            "thrust_headroom": (max(low, min(least, 0.9 * hover)), min(high, max(most, 1.1 * hover))),
        }
    )


def checked(limits: Limits, on_board: CheckedLimits) -> CheckedLimits:
    """Return the limits that judge the reference: never looser than those on board."""

    def tighter(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
        return max(a[0], b[0]), min(a[1], b[1])

    rate = tuple(map(min, limits.body_rate_max_rad_s, on_board.body_rate_max_rad_s))
    fence = tuple(map(tighter, limits.geofence_m, on_board.geofence_m))
    return dataclasses.replace(
        on_board,
        speed_max_m_s=min(limits.speed_max_m_s, on_board.speed_max_m_s),
        tilt_max_deg=min(limits.tilt_max_deg, on_board.tilt_max_deg),
        body_rate_max_rad_s=(rate[0], rate[1], rate[2]),
        jerk_max_m_s3=min(limits.jerk_max_m_s3, on_board.jerk_max_m_s3),
        thrust_headroom=tighter(limits.thrust_headroom, on_board.thrust_headroom),
        geofence_m=(fence[0], fence[1], fence[2]),
    )


def worst(margins: Mapping[str, float]) -> float:
    """Return the least margin; infinity without any."""
    return min(margins.values(), default=math.inf)
