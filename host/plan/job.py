"""One planning job: its arguments, and the finished plan from a judged table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.plan.clearance import predicted_error_max_m
from trimtab.host.plan.dynamics import Dynamics
from trimtab.host.plan.judge import Judged, judge, measure, obstacle_margins, passings
from trimtab.host.plan.result import Kind, Plan, Settings, label
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import Table, snap_table
from trimtab.host.route import Route
from trimtab.host.route.clearance import has_obstacles
from trimtab.host.vehicle import Limits
from trimtab.protocol.blobs import BLOB_BYTES_MAX, YawNode


@dataclass(frozen=True, kw_only=True)
class Effort:
    """The effort of a plan; fields as of `Plan`."""

    status: str
    solve_s: float
    first_solve_s: float | None = None
    rounds: int = 1
    iterations: int = 0
    intervals: int = 0
    stretch: float = 1.0
    deviation_m: float | None = None
    lambda_r: float | None = None


@dataclass(frozen=True, kw_only=True)
class Job:
    """A route to plan, with the checked arguments of `plan`. limits: all limits that apply, merged.

    course: the route as asked for. route: the same with `clearance_m` taken off its gates and added to its
    keep-out shapes, which is what the path is planned and judged through.
    """

    kind: Kind
    course: Route
    route: Route
    clearance_m: float
    dynamics: Dynamics
    limits: Limits
    settings: Settings

    @property
    def label(self) -> str:
        """The kind as the paper writes it, with a star for augmented dynamics."""
        return label(self.kind, self.dynamics.augmented)

    @property
    def waypoints_ned(self) -> Annotated[np.ndarray, "waypoints 3"]:
        """Waypoints, m."""
        return np.array(self.route.waypoints_m)

    def durations(self) -> Annotated[np.ndarray, "legs"]:
        """Return the route's durations, or those of least snap."""
        if self.route.times_s is not None:
            return np.diff(np.array(self.route.times_s))
        route = self.route
        return optimise_durations(self.waypoints_ned, route.duration_s, route.end_velocities_ned)

    def snap(self, durations_s: Annotated[np.ndarray, "legs"]) -> Table:
        """Return the min-snap table with these leg times."""
        return snap_table(self.waypoints_ned, durations_s, self.route.end_velocities_ned)

    def yaws(self, scale: float = 1.0) -> tuple[YawNode, ...]:
        """Return the route's yaw nodes with their times scaled."""
        return tuple(
            YawNode(round(t_s * scale * 1e6), yaw, rate / scale) for t_s, yaw, rate in self.route.yaw.nodes()
        )

    @property
    def yaw_rate_max_rad_s(self) -> float | None:
        """Greatest rate of a free heading; None where the heading is given, and for min-snap."""
        return None if self.kind == "min-snap" else self.route.yaw.rate_max_rad_s

    def passed(self, p_ned: Annotated[np.ndarray, "waypoints 3"]) -> Annotated[np.ndarray, "waypoints 3"]:
        """Return where a path must pass exactly, if it solves the waypoints at p_ned."""
        out = self.waypoints_ned
        for gate in self.route.gates or ():
            out[gate.waypoint] = gate.nearest(p_ned[gate.waypoint], out[gate.waypoint])
        return out

    def judge(
        self, table: Table, yaws: tuple[YawNode, ...], waypoint_times_s: Annotated[np.ndarray, "waypoints"]
    ) -> Judged:
        """Return the verdict on a table."""
        route, gates = self.route, passings(self.route, waypoint_times_s)
        vehicle, yaw_rate = self.dynamics.vehicle, self.yaw_rate_max_rad_s
        return judge(table, yaws, vehicle, self.limits, route.keep_out, gates, yaw_rate, self.clearance_m)

    def finish(
        self, judged: Judged, waypoint_times_s: Annotated[np.ndarray, "waypoints"], effort: Effort
    ) -> Plan:
        """Return the plan. Raises UsageError where the vehicle has no room for its reference."""
        size = len(judged.reference.to_bytes())
        if size > BLOB_BYTES_MAX:
            raise UsageError(
                f"{self.route.name}: {len(judged.reference.nodes)} nodes take {size} bytes, the vehicle has "
                f"room for {BLOB_BYTES_MAX}; give the route less time or fewer waypoints and headings"
            )
        vehicle, model = self.dynamics.vehicle, self.dynamics.model
        figures = measure(vehicle, model, judged.table, judged.reference.yaw_nodes())
        gates = passings(self.course, waypoint_times_s)
        return Plan(
            reference=judged.reference,
            route=self.course,
            kind=self.kind,
            augmented=self.dynamics.augmented,
            status=effort.status,
            duration_s=judged.reference.duration_us * 1e-6,
            waypoint_times_s=tuple(map(float, waypoint_times_s)),
            limits=self.limits,
            margins={**judged.margins, **obstacle_margins(judged.table, self.course.keep_out, gates)},
            clearance_m=self.clearance_m if has_obstacles(self.course) else None,
            predicted_error_max_m=predicted_error_max_m(vehicle, model, judged.reference),
            residual_rms_m_s2=figures.residual_rms_m_s2,
            outside_region=figures.outside_region,
            path_length_m=figures.path_length_m,
            mean_speed_m_s=figures.mean_speed_m_s,
            deviation_m=effort.deviation_m,
            stretch=effort.stretch,
            lambda_r=effort.lambda_r,
            intervals=effort.intervals,
            rounds=effort.rounds,
            iterations=effort.iterations,
            solve_s=effort.solve_s,
            first_solve_s=effort.first_solve_s,
        )
