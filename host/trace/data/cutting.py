"""From flight logs to segments on a regular grid, with an audit of what was left out and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.host.trace.data.audit import Audit, audit
from trimtab.host.trace.data.segments import BIN_S, PATH_S, Segments
from trimtab.host.trace.data.signals import FlightData, Signals, averaged, noise, pose_interval_s
from trimtab.host.trace.decision.findings import Code, Finding, LogsRefused
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.sentences import MIXED_INPUTS, too_few_segments

DT_S = 0.01
SEGMENT_S = 0.6
LAGS = 5
"""Run-up of the rotors before a segment, in nominal lags."""


def segments_of(
    flights: Sequence[FlightData], *, rate_driven: bool, segment_s: float = SEGMENT_S
) -> tuple[Segments, tuple[Audit, ...]]:
    """Return all usable segments of the flights, of one vehicle, and what was left out of each.

    rate_driven: the measured body rate drives the attitude, since the torque is unknown. Raises
    LogsRefused when too few segments are left.
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
    found = Segments(dt_s=DT_S, in_newton=in_newton, rate_driven=rate_driven, paths=paths, **arrays)
    return found, tuple(audits)


def _refusal(audits: Sequence[Audit], count: int, segment_s: float) -> str:
    """Return the refusal of logs with too few usable segments."""
    lost = {audit.log: audit.findings if audit.left_out else () for audit in audits}
    return too_few_segments(lost, count, segment_s)


def _paths(flights: Sequence[FlightData]) -> np.ndarray:
    """Measured state (flights, n, 12) from each flight's first pose on, each PATH_S; body rate 0.

    Flights that end earlier stand at their last state.
    """
    each = []
    for data in flights:
        s = data.signals
        t = np.arange(s.pose_s[0], s.pose_s[-1] + 0.5 * PATH_S, PATH_S)
        p = np.column_stack([np.interp(t, s.pose_s, s.p_ned[:, i]) for i in range(3)])
        at = np.minimum(np.searchsorted(s.pose_s, t), len(s.pose_s) - 1)
        yaw, pitch, roll = Rotation.from_matrix(s.R_ned_frd[at]).as_euler("ZYX").T
        v = np.gradient(p, PATH_S, axis=0)
        each.append(np.column_stack([p, v, roll, pitch, yaw, np.zeros((len(t), 3))]))
    longest = max(len(path) for path in each)
    return np.stack([np.pad(path, ((0, longest - len(path)), (0, 0)), mode="edge") for path in each])


def _cut(
    data: FlightData, index: int, segment_s: float, rate_driven: bool
) -> tuple[list[dict[str, Any]], Audit]:
    flight, s = data.flight, data.signals
    sigma = noise(s)
    steps = round(segment_s / DT_S)
    pre = max(1, int(np.ceil(LAGS * flight.vehicle.motor_lag_s / DT_S)))
    begin = max(s.span_s[0], s.pose_s[0] + (pre + 2) * DT_S, s.input_s[0, 0] + (pre + 2) * DT_S)
    count = int((s.span_s[1] - begin) / segment_s)
    grid = begin + DT_S * np.arange(-pre, count * steps + 1)
    command, covered = averaged(grid, s.input_s, s.command)
    nothing = np.zeros((len(grid) - 1, 3)), np.zeros(len(grid) - 1)
    rate, rate_share = averaged(grid, s.imu_s, s.rate_frd) if len(s.rate_frd) else nothing
    force, force_share = averaged(grid, s.imu_s, s.force_frd) if len(s.force_frd) else nothing
    ratio = np.interp(grid, s.voltage_s, s.voltage_ratio)
    nearest = np.round((s.pose_s - begin) / DT_S).astype(int) + pre
    distance = np.abs(s.pose_s - (begin + DT_S * (nearest - pre)))
    order = np.lexsort((distance, nearest))
    keep = order[np.unique(nearest[order], return_index=True)[1]]
    keep = keep[(nearest[keep] >= 0) & (nearest[keep] < len(grid))]
    at = np.full(len(grid), -1)
    at[nearest[keep]] = keep
    fewest = (1.0 - RULES.missing_share) * min(1.0, DT_S / pose_interval_s(s))

    health = audit(data)
    found: list[dict[str, Any]] = []
    thin, lost = 0, dict[Code, int]()
    for k in range(count):
        a = pre + k * steps
        start_s = float(grid[a] - s.span_s[0])
        bad = health.overlaps(start_s, start_s + segment_s)
        if bad is not None:
            lost[bad.code] = lost.get(bad.code, 0) + 1
            continue
        pick = at[a : a + steps]
        here = pick >= 0
        fed = covered[a - pre : a + steps] > RULES.min_coverage
        if (
            here.mean() < fewest
            or fed.mean() < 1 - RULES.missing_share
            or not here[: max(2, steps // 6)].any()
        ):
            thin += 1
            continue
        R = s.R_ned_frd[np.where(here, pick, 0)]
        found.append(
            {
                "in_newton": s.in_newton,
                "flight": np.array(index),
                "start_s": np.array(start_s),
                "x0": _initial(s, grid[a], rate[a] if rate_share[a] > RULES.min_coverage else None),
                "p_ned": s.p_ned[np.where(here, pick, 0)],
                "R_ned_frd": R.reshape(steps, 9),
                "shift_s": np.where(here, s.pose_s[np.where(here, pick, 0)] - grid[a : a + steps], 0.0),
                "pose_weight": here.astype(float),
                "rate_frd": rate[a : a + steps],
                "rate_weight": (rate_share[a : a + steps] > RULES.min_coverage)
                * (0.0 if rate_driven else 1.0),
                "force_frd": force[a : a + steps],
                "force_weight": (force_share[a : a + steps] > RULES.min_coverage).astype(float),
                "command": command[a - pre : a + steps],
                "voltage_ratio": ratio[a : a + steps],
                "disturbance_frd": np.zeros((round(segment_s / BIN_S), 6)),
                "path_start_s": np.array(grid[a] - s.pose_s[0]),
                "sigma": sigma,
            }
        )
    log = flight.path.name
    findings = [
        Finding(code=Code.SEGMENTS_LEFT_OUT, value=count, unit="segments", subject=(str(code),), log=log)
        for code, count in lost.items()
    ]
    if thin:
        findings.append(Finding(code=Code.SEGMENTS_WITH_GAPS, value=thin, unit="segments", log=log))
    return found, replace(
        health,
        used_s=len(found) * segment_s,
        segments=len(found),
        left_out=thin + sum(lost.values()),
        findings=(*findings, *health.findings),
    )


def _initial(s: Signals, t: float, rate: np.ndarray | None) -> np.ndarray:
    """Return initial state (12,) at t: local quadratic through the positions, attitude of the nearest pose,
    body rate; where no gyro says that, how the poses turn.
    """
    near = np.flatnonzero(np.abs(s.pose_s - t) < 0.06)
    if len(near) < 4:
        near = np.argsort(np.abs(s.pose_s - t))[:4]
    fit = np.polynomial.polynomial.polyfit(s.pose_s[near] - t, s.p_ned[near], 2)
    nearest = near[np.argmin(np.abs(s.pose_s[near] - t))]
    if rate is None:
        turned = Rotation.from_matrix(s.R_ned_frd[nearest].T @ s.R_ned_frd[near]).as_rotvec()
        rate = np.polynomial.polynomial.polyfit(s.pose_s[near] - t, turned, 1)[1]
    yaw, pitch, roll = Rotation.from_matrix(s.R_ned_frd[nearest]).as_euler("ZYX")
    return np.concatenate([fit[0], fit[1], [roll, pitch, yaw], rate])
