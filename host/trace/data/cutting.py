"""Cutting of flight logs into segments on a regular grid, with an audit of the parts that are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.trace.data.audit import Audit, audit
from trimtab.host.trace.data.segments import BIN_S, PATH_S, Segments
from trimtab.host.trace.data.signals import FlightData, Signals, averaged, noise, pose_interval_s
from trimtab.host.trace.decision.findings import Code, Finding, LogsRefused
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.sentences import MIXED_INPUTS, too_few_segments

DT_S = 0.01
"""Step of the grid."""
SEGMENT_S = 0.6
"""Length of a segment."""
RUN_UP_LAGS = 5
"""Time before a segment over which commands are simulated, so that rotor thrusts are right at its start; in
nominal motor lags."""


def segments_of(
    flights: Sequence[FlightData], *, rate_driven: bool, segment_s: float = SEGMENT_S
) -> tuple[Segments, tuple[Audit, ...]]:
    """Return all usable segments of the flights of one vehicle, and the audit of each flight.

    rate_driven: whether the measured body rate drives the attitude, since the torque is unknown. segment_s:
    length of a segment. Raises LogsRefused if too few segments are usable, or if some logs record motor
    commands and others thrusts or no inputs.
    """
    parts, audits = [], []
    for index, data in enumerate(flights):
        part, audit = _cut(data, index, segment_s, rate_driven)
        audits.append(audit)
        parts += part
    if len(parts) < RULES.min_segments:
        raise LogsRefused(Code.TOO_FEW_SEGMENTS, _refusal(audits, len(parts), segment_s))
    if len({bool(p["in_newton"]) for p in parts}) > 1:
        raise LogsRefused(Code.MIXED_INPUTS, MIXED_INPUTS)
    arrays = {key: np.stack([p[key] for p in parts]) for key in parts[0] if key != "in_newton"}
    in_newton = bool(parts[0]["in_newton"])
    paths = _paths(flights)
    segments = Segments(dt_s=DT_S, in_newton=in_newton, rate_driven=rate_driven, paths=paths, **arrays)
    return segments, tuple(audits)


def _refusal(audits: Sequence[Audit], count: int, segment_s: float) -> str:
    """Return the error message for logs with too few usable segments."""
    lost = {audit.log: audit.findings if audit.left_out else () for audit in audits}
    return too_few_segments(lost, count, segment_s)


def _paths(flights: Sequence[FlightData]) -> np.ndarray:
    """Return the measured states (flights, n, 12) every PATH_S from the first pose of each flight on.

    A state is p, v NED, Euler angles Theta, and a body rate of 0. Shorter flights are padded with their last
    state.
    """
    paths = []
    for data in flights:
        s = data.signals
        t = np.arange(s.pose_s[0], s.pose_s[-1] + 0.5 * PATH_S, PATH_S)
        p = np.column_stack([np.interp(t, s.pose_s, s.p_ned[:, i]) for i in range(3)])
        pose = np.minimum(np.searchsorted(s.pose_s, t), len(s.pose_s) - 1)
        yaw, pitch, roll = Rotation.from_matrix(s.R_ned_frd[pose]).as_euler("ZYX").T
        v = np.gradient(p, PATH_S, axis=0)
        paths.append(np.column_stack([p, v, roll, pitch, yaw, np.zeros((len(t), 3))]))
    longest = max(len(path) for path in paths)
    return np.stack([np.pad(path, ((0, longest - len(path)), (0, 0)), mode="edge") for path in paths])


@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Measurements of one flight on a regular grid of DT_S.

    t_s: times of the grid, since arming. run_up: index at which the first segment begins. count: number of
    segments. steps: steps in a segment. command, rate_frd, force_frd: means over each interval between two
    times; command_share, rate_share, force_share: share of the interval that samples cover. pose: index of
    the nearest pose. posed: whether it is within half a step. p_ned: its position, interpolated if it is not.
    """

    t_s: Annotated[np.ndarray, "times"]
    run_up: int
    steps: int
    count: int
    command: Annotated[np.ndarray, "intervals 4"]
    command_share: Annotated[np.ndarray, "intervals"]
    rate_frd: Annotated[np.ndarray, "intervals 3"]
    rate_share: Annotated[np.ndarray, "intervals"]
    force_frd: Annotated[np.ndarray, "intervals 3"]
    force_share: Annotated[np.ndarray, "intervals"]
    voltage_ratio: Annotated[np.ndarray, "times"]
    pose: Annotated[np.ndarray, "times"]
    posed: Annotated[np.ndarray, "times"]
    p_ned: Annotated[np.ndarray, "times 3"]


def _grid(data: FlightData, segment_s: float) -> _Grid:
    """Return the measurements of `data` on the grid of its segments."""
    s = data.signals
    steps = round(segment_s / DT_S)
    run_up = max(1, int(np.ceil(RUN_UP_LAGS * data.flight.vehicle.motor_lag_s / DT_S)))
    begin = max(s.span_s[0], s.pose_s[0] + (run_up + 2) * DT_S, s.input_s[0, 0] + (run_up + 2) * DT_S)
    count = int((s.span_s[1] - begin) / segment_s)
    t_s = begin + DT_S * np.arange(-run_up, count * steps + 1)
    command, command_share = averaged(t_s, s.input_s, s.command)
    missing = np.zeros((len(t_s) - 1, 3)), np.zeros(len(t_s) - 1)
    rate, rate_share = averaged(t_s, s.imu_s, s.rate_frd) if len(s.rate_frd) else missing
    force, force_share = averaged(t_s, s.imu_s, s.force_frd) if len(s.force_frd) else missing
    nearest = np.round((s.pose_s - begin) / DT_S).astype(int) + run_up
    distance_s = np.abs(s.pose_s - (begin + DT_S * (nearest - run_up)))
    order = np.lexsort((distance_s, nearest))
    closest = order[np.unique(nearest[order], return_index=True)[1]]
    closest = closest[(nearest[closest] >= 0) & (nearest[closest] < len(t_s))]
    pose = np.searchsorted(0.5 * (s.pose_s[1:] + s.pose_s[:-1]), t_s)
    pose[nearest[closest]] = closest
    posed = np.zeros(len(t_s), dtype=bool)
    posed[nearest[closest]] = True
    between = np.column_stack([np.interp(t_s, s.pose_s, axis) for axis in s.p_ned.T])
    return _Grid(
        t_s=t_s,
        run_up=run_up,
        steps=steps,
        count=count,
        command=command,
        command_share=command_share,
        rate_frd=rate,
        rate_share=rate_share,
        force_frd=force,
        force_share=force_share,
        voltage_ratio=np.interp(t_s, s.voltage_s, s.voltage_ratio),
        pose=pose,
        posed=posed,
        p_ned=np.where(posed[:, None], s.p_ned[pose], between),
    )


def _cut(
    data: FlightData, index: int, segment_s: float, rate_driven: bool
) -> tuple[list[dict[str, Any]], Audit]:
    """Return the usable segments of one flight, as fields of `Segments`, and its audit."""
    grid = _grid(data, segment_s)
    sigma = noise(data.signals)
    min_poses = (1.0 - RULES.missing_share) * min(1.0, DT_S / pose_interval_s(data.signals))
    health = audit(data)
    segments: list[dict[str, Any]] = []
    with_gaps, left_out = 0, dict[Code, int]()
    for k in range(grid.count):
        first = grid.run_up + k * grid.steps
        start_s = float(grid.t_s[first] - data.signals.span_s[0])
        stretch = health.first_overlap(start_s, start_s + segment_s)
        if stretch is not None:
            left_out[stretch.code] = left_out.get(stretch.code, 0) + 1
        elif _has_gaps(grid, first, min_poses):
            with_gaps += 1
        else:
            fields = _segment(grid, data.signals, first, rate_driven)
            segments.append(
                fields | {"flight": np.array(index), "start_s": np.array(start_s), "sigma": sigma}
            )
    log = data.flight.path.name
    findings = [
        Finding(code=Code.SEGMENTS_LEFT_OUT, value=count, unit="segments", subject=(str(code),), log=log)
        for code, count in left_out.items()
    ]
    if with_gaps:
        findings.append(Finding(code=Code.SEGMENTS_WITH_GAPS, value=with_gaps, unit="segments", log=log))
    return segments, replace(
        health,
        used_s=len(segments) * segment_s,
        segments=len(segments),
        left_out=with_gaps + sum(left_out.values()),
        findings=(*findings, *health.findings),
    )


def _has_gaps(grid: _Grid, first: int, min_poses: float) -> bool:
    """Return whether too few poses or commands cover the segment that begins at index `first`.

    min_poses: share of the steps that need a pose.
    """
    posed = grid.posed[first : first + grid.steps]
    commanded = grid.command_share[first - grid.run_up : first + grid.steps] > RULES.min_coverage
    return bool(
        posed.mean() < min_poses
        or commanded.mean() < 1 - RULES.missing_share
        or not posed[: max(2, grid.steps // 6)].any()
    )


def _segment(grid: _Grid, s: Signals, first: int, rate_driven: bool) -> dict[str, Any]:
    """Return the fields of the segment that begins at index `first`; see `Segments` for their shapes."""
    steps = grid.steps
    inside = slice(first, first + steps)
    pose, posed = grid.pose[inside], grid.posed[inside]
    rate_covered = grid.rate_share[inside] > RULES.min_coverage
    return {
        "in_newton": s.in_newton,
        "x0": _initial(s, grid.t_s[first], grid.rate_frd[first] if rate_covered[0] else None),
        "p_ned": grid.p_ned[inside],
        "R_ned_frd": s.R_ned_frd[pose].reshape(steps, 9),
        "shift_s": np.where(posed, s.pose_s[pose] - grid.t_s[inside], 0.0),
        "pose_weight": posed.astype(float),
        "rate_frd": grid.rate_frd[inside],
        "rate_weight": rate_covered * (0.0 if rate_driven else 1.0),
        "force_frd": grid.force_frd[inside],
        "force_weight": (grid.force_share[inside] > RULES.min_coverage).astype(float),
        "command": grid.command[first - grid.run_up : first + steps],
        "voltage_ratio": grid.voltage_ratio[inside],
        "disturbance_frd": np.zeros((round(steps * DT_S / BIN_S), 6)),
        "path_start_s": np.array(grid.t_s[first] - s.pose_s[0]),
    }


def _initial(s: Signals, t: float, rate: np.ndarray | None) -> np.ndarray:
    """Return the initial state (12,) at time t: p, v NED, Euler angles Theta, body rate FRD.

    Position and velocity come from a local quadratic through the positions, the attitude from the nearest
    pose. rate (3,): measured body rate, rad/s, FRD; None to use the slope of the attitudes.
    """
    near = np.flatnonzero(np.abs(s.pose_s - t) < 0.06)
    if len(near) < 4:
        near = np.argsort(np.abs(s.pose_s - t))[:4]
    fit = np.polynomial.polynomial.polyfit(s.pose_s[near] - t, s.p_ned[near], 2)
    nearest = near[np.argmin(np.abs(s.pose_s[near] - t))]
    if rate is None:
        rotation = Rotation.from_matrix(s.R_ned_frd[nearest].T @ s.R_ned_frd[near]).as_rotvec()
        rate = np.polynomial.polynomial.polyfit(s.pose_s[near] - t, rotation, 1)[1]
    yaw, pitch, roll = Rotation.from_matrix(s.R_ned_frd[nearest]).as_euler("ZYX")
    return np.concatenate([fit[0], fit[1], [roll, pitch, yaw], rate])
