"""What planned flights tell: the information of a flight that the vehicle has not flown yet.

The information is computed in the linearisation of command-driven segments. States come from the planned
motion; commands from the nominal vehicle; sensors, battery and disturbance from the flights so far.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.flatness import Body, flat_full
from trimtab.firmware_model.law.rotations import matrix_to_euler
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.trace import evidence
from trimtab.host.trace.data.cutting import DT_S, RUN_UP_LAGS, SEGMENT_S
from trimtab.host.trace.data.segments import BIN_S, PATH_S, Segments
from trimtab.host.trace.linearisation import DisturbanceVariances
from trimtab.host.trace.segment_fit import linearise, rollout
from trimtab.host.trace.segment_fit.fit import SegmentFit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.vehicle import Vehicle
from trimtab.host.vehicle.allocation import allocation_inverse

_ROLLED = 12
"""Segments of a manoeuvre that are rolled out, evenly spaced. Others count as the nearest of them."""

_TURNS = 2
"""Roll-outs from which the disturbance that keeps a manoeuvre on its path is computed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Instruments:
    """Sensors, battery and disturbance that a planned flight is assumed to have.

    Attributes
    ----------
    sigma
        Standard deviations of means over DT_S: position m, attitude rad, body rate rad/s, specific force
        m/s^2.
    shares
        Shares of the steps that have a pose, a body rate and a specific force.
    voltage
        Battery voltage over full voltage at the start, and its slope in 1/s.
    process
        Process disturbance.
    in_newton
        Whether commands are rotor thrusts in N.
    rate_driven
        Whether the measured body rate drives the attitude.
    """

    sigma: Annotated[np.ndarray, "4"]
    shares: Annotated[np.ndarray, "3"]
    voltage: Annotated[np.ndarray, "2"]
    process: DisturbanceVariances
    in_newton: bool
    rate_driven: bool

    def __post_init__(self) -> None:
        if self.sigma.shape != (4,) or not (self.sigma > 0).all():
            raise ValueError(f"sigma {self.sigma} must be four positive numbers")
        if self.shares.shape != (3,) or self.voltage.shape != (2,):
            raise ValueError(f"{self.shares} must be three shares, {self.voltage} a ratio and its slope")

    @classmethod
    def of(cls, fit: SegmentFit) -> Instruments:
        """Return the mean sensors and battery of the flights, with noise and process of the fit."""
        data = fit.data
        t_s = np.repeat(data.start_s[:, None], data.steps, axis=1) + DT_S * np.arange(data.steps)
        slope, start = np.polyfit(t_s.ravel(), data.voltage_ratio.ravel(), 1)
        return cls(
            sigma=np.sqrt(fit.lin.variance_factor) * data.sigma.mean(0),
            shares=np.array([w.mean() for w in (data.pose_weight, data.rate_weight, data.force_weight)]),
            voltage=np.array([start, slope]),
            process=fit.process,
            in_newton=data.in_newton,
            rate_driven=data.rate_driven,
        )


def information(
    segment_model: SegmentModel,
    flat: Annotated[np.ndarray, "14 times"],
    theta_scaled: Annotated[np.ndarray, "parameters"],
    instruments: Instruments,
) -> Annotated[np.ndarray, "parameters parameters"] | None:
    """Return the information of one flight along flat outputs; None if it is too short.

    It is S' S of the whitened slopes S, with the nuisances of the flight integrated out. A flight is too
    short if it holds no segment.

    Parameters
    ----------
    segment_model
        Model of the segments.
    flat
        Flat outputs every DT_S, as in `Manoeuvre.flat`.
    theta_scaled
        Scaled parameters of the linearisation.
    instruments
        Sensors, battery and disturbance of the flight.
    """
    data = _along(segment_model.vehicle, flat, instruments)
    if data is None:
        return None
    count = len(data.flight)
    rolled = np.unique(np.round(np.linspace(0, count - 1, min(count, _ROLLED))).astype(int))
    nearest = np.abs(np.arange(count)[:, None] - rolled).argmin(axis=1)
    part, nuisances = data.take(rolled), np.zeros((len(rolled), segment_model.nuisances))
    part = _kept_on_path(segment_model, part, theta_scaled)
    # Each rolled-out segment is a flight of its own here, so that its Gram can stand for its neighbours'.
    part = replace(part, flight=np.arange(len(rolled)), paths=np.repeat(part.paths, len(rolled), axis=0))
    basis = linearise.basis(segment_model, part, theta_scaled, nuisances)
    lin, _ = linearise.linearise(segment_model, part, theta_scaled, nuisances, basis)
    lin = replace(
        lin,
        own=lin.own[nearest],
        square=lin.square[nearest],
        cross=lin.cross[nearest],
        piece=np.arange(count),
        piece_flight=data.flight,
        nuisances=nuisances[:1],
    )
    return evidence.marginal_grams(lin, instruments.process, segment_model.space.prior).gram[1:, 1:]


def _kept_on_path(segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray) -> Segments:
    """Return the segments with a disturbance that keeps roll-outs at theta_scaled on their path.

    The commands are those of the nominal vehicle, so a roll-out at theta_scaled would leave the path. The
    disturbance is an angular acceleration, computed from the error of the body rate. Forces do not rotate the
    vehicle and are not compensated.
    """
    start = data.x0.T[:, None, :]
    nuisances = np.zeros((segment_model.nuisances, *start.shape[1:]))
    point = segment_model.space.of_flight(theta_scaled, 0)[:, None]
    per_bin = round(BIN_S / data.dt_s)
    for _ in range(_TURNS):
        predicted = rollout.roll_out(segment_model, data, start, point, nuisances)[:, 6:9, 0]
        error = data.rate_frd - np.transpose(predicted, (2, 0, 1))
        inner = 0.5 * (error[:, per_bin - 1 : -1 : per_bin] + error[:, per_bin::per_bin])
        edges = np.concatenate([np.zeros_like(error[:, :1]), inner, error[:, -1:]], axis=1)
        w = data.disturbance_frd.copy()
        w[:, :, 3:] += np.diff(edges, axis=1) / BIN_S
        data = data.with_w(w)
    return data


def _along(vehicle: Vehicle, flat: np.ndarray, instruments: Instruments) -> Segments | None:
    """Return the segments of a flight that follows flat outputs exactly; None if it is too short."""
    steps = round(SEGMENT_S / DT_S)
    pre = max(1, int(np.ceil(RUN_UP_LAGS * vehicle.motor_lag_s / DT_S)))
    count = (flat.shape[1] - pre - 1) // steps
    if count < 1:
        return None
    thrust, R, rate = flat_commands(vehicle, flat)
    if instruments.in_newton:
        command = thrust
    else:
        c1, c2 = vehicle.thrust_curve
        share = np.clip(thrust / vehicle.thrust_max_n, 0.0, 1.0)
        command = share if c2 == 0 else (np.sqrt(c1 * c1 + 4 * c2 * share) - c1) / (2 * c2)
    rpy = np.array(matrix_to_euler(NUMPY, list(R.T))).T
    first = pre + steps * np.arange(count)
    inside = first[:, None] + np.arange(steps)
    with_run_up = first[:, None] + np.arange(-pre, steps)
    n = (count, steps)
    start, slope = instruments.voltage
    # A measurement in a share s of the steps has the information of one of weight sqrt(s) in every step.
    pose, gyro, accelerometer = np.sqrt(instruments.shares)
    return Segments(
        dt_s=DT_S,
        flight=np.zeros(count, dtype=int),
        start_s=first * DT_S,
        x0=np.column_stack([flat[0:3, first].T, flat[3:6, first].T, rpy[first], rate[first]]),
        p_ned=flat[0:3].T[inside],
        R_ned_frd=R[inside],
        shift_s=np.zeros(n),
        pose_weight=np.full(n, pose),
        rate_frd=rate[inside],
        rate_weight=np.full(n, gyro),
        force_frd=np.zeros((*n, 3)),
        force_weight=np.full(n, accelerometer),
        command=command[with_run_up],
        voltage_ratio=start + slope * DT_S * inside,
        sigma=np.repeat(instruments.sigma[None], count, axis=0),
        disturbance_frd=np.zeros((count, round(SEGMENT_S / BIN_S), 6)),
        path_start_s=first * DT_S,
        paths=np.column_stack([flat[0:3].T, flat[3:6].T, rpy, rate])[None, :: round(PATH_S / DT_S)],
        in_newton=instruments.in_newton,
        rate_driven=instruments.rate_driven,
    )


def flat_commands(
    vehicle: Vehicle, flat: Annotated[np.ndarray, "14 times"]
) -> tuple[
    Annotated[np.ndarray, "times 4"], Annotated[np.ndarray, "times 9"], Annotated[np.ndarray, "times 3"]
]:
    """Return the nominal rotor thrusts, attitude and body rate along flat outputs.

    flat: flat outputs every DT_S, as in `Manoeuvre.flat`. Returns rotor thrusts in N, R_ned_frd, row-major,
    and body rate in rad/s, FRD.
    """
    snap = np.gradient(flat[9:12], DT_S, axis=1)
    body = Body(vehicle.mass_kg, vehicle.inertia_kg_m2)
    R, rate, _, collective, torque = flat_full(
        NUMPY, list(flat[6:9]), list(flat[9:12]), list(snap), flat[12], flat[13], body
    )
    shape = flat.shape[1]
    wrench = np.array([np.broadcast_to(row, shape) for row in (collective, *torque)])
    attitude = np.array([np.broadcast_to(row, shape) for row in R]).T
    return (
        (allocation_inverse(vehicle) @ wrench).T,
        attitude,
        np.array([np.broadcast_to(r, shape) for r in rate]).T,
    )
