"""Roll-outs of whole flights in closed loop, and their residuals.

The closed-loop model phi is driven by the reference through the control law, not by measurements. Poses, body
rate and rate integral are compared as means over bins, as telemetry records them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
from scipy.sparse import csr_array

from trimtab.host.base import parallel
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.slots import mocap_latency_s as latency_of
from trimtab.host.models.states import States, flight_states
from trimtab.host.trace.data.signals import FlightData, Signals
from trimtab.host.trace.flight_fit.recording import PER_BIN, SAMPLE_S, Recording, interpolation, record
from trimtab.host.trace.flight_fit.whitening import CHANNELS, affordable
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.vehicle import Vehicle

STABLE = 2.5
"""Greatest |eigenvalue| times step for which RK4 is stable. Modes this fast need not be accurate here."""

Result = TypeVar("Result")

_THETA_STEP = 1e-4
"""Step of the difference quotients, scaled."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Loop:
    """The closed loop of one flight: inputs of `roll_out`.

    fine: integration steps in SAMPLE_S.
    """

    phi: Phi
    fine: int
    x0: Annotated[np.ndarray, "states"]
    drive: Annotated[np.ndarray, "stages 23"]
    constants: Annotated[np.ndarray, "15"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Slopes:
    """Derivatives of the predictions of flights: `slopes[index]` is (parameters, bins, 12).

    They are stored in single precision, which is more accurate than their difference quotients.

    parameters: number of parameters. rows: indices of the parameters in `latest`. latest: derivatives of each
    flight, (rows, bins, 12). earlier: those of all parameters that have any, from an earlier point; empty if
    `rows` are all of them.
    """

    parameters: int
    rows: Sequence[int]
    latest: Sequence[np.ndarray]
    earlier: Slopes | None

    def __getitem__(self, index: int) -> Annotated[np.ndarray, "parameters bins 12"]:
        latest = self.latest[index]
        if self.earlier is None:
            slopes = np.zeros((self.parameters, *latest.shape[1:]))
        else:
            slopes = self.earlier[index]
        slopes[self.rows] = latest
        return slopes


class ClosedLoop:
    """Closed-loop model phi with the effects of a parameter space, over recordings of whole flights.

    jobs: threads that predict flights.
    """

    def __init__(
        self, recordings: Sequence[Recording], vehicle: Vehicle, space: ParameterSpace, *, jobs: int = 1
    ) -> None:
        self.recordings, self.space, self.jobs = tuple(recordings), space, jobs
        self._rows = [i for name in space.parts for i in space.owners[name]]
        self._products = {i for name in space.parts if space.effects[name].memory for i in space.owners[name]}
        self._slopes: Slopes | None = None
        effects = tuple(space.effects[name] for name in space.parts)
        phis: dict[tuple[tuple[str, float], ...], Phi] = {}
        self._loops: list[_Loop] = []
        for recording in recordings:
            parameters = recording.states.parameters
            key = tuple(sorted((parameters or {}).items()))
            if key not in phis:
                phis[key] = Phi(vehicle=vehicle, effects=effects, parameters=parameters)
            phi = phis[key]
            fine = max(1, math.ceil(phi.stiffness * SAMPLE_S / STABLE))
            stages = half_steps(0.0, recording.bins * PER_BIN * fine, SAMPLE_S / fine)
            self._loops.append(
                _Loop(
                    phi=phi,
                    fine=fine,
                    x0=recording.states.initial(phi),
                    drive=_drive(recording.states, stages),
                    constants=recording.states.constants,
                )
            )

    @property
    def known(self) -> list[np.ndarray]:
        """Masks (bins,), one for each flight, of the bins in which all channels were measured."""
        return [recording.known for recording in self.recordings]

    def each(self, work: Callable[[int], Result]) -> list[Result]:
        """Return `work` of the index of every flight."""
        return parallel.each(work, range(len(self.recordings)), self.jobs)

    def predicted(
        self, index: int, theta_scaled: Annotated[np.ndarray, "parameters lanes"]
    ) -> Annotated[np.ndarray, "lanes bins 12"]:
        """Return predicted bin means of one flight at theta_scaled.

        The channels are those of `Recording.measured`.
        """
        loop = self._loops[index]
        theta = self.space.values(theta_scaled)[self._rows]
        latency_s = np.broadcast_to(np.asarray(latency_of(NUMPY, loop.phi.parts(theta))), theta.shape[1:])
        samples = roll_out(
            loop.phi,
            x0=np.repeat(loop.x0[:, None], theta.shape[1], axis=1),
            drive=loop.drive,
            flight=loop.constants,
            theta=theta,
            step_s=SAMPLE_S / loop.fine,
            every=loop.fine,
            rows=INTEGRAL.stop,
            compiled=True,
        )
        return _means(self.recordings[index], samples, latency_s)

    def residual(
        self, index: int, theta_scaled: Annotated[np.ndarray, "parameters lanes"]
    ) -> Annotated[np.ndarray, "lanes bins 12"]:
        """Return the residual of one flight, measured minus predicted.

        Position is resolved along the heading, attitude in FRD. The body-rate residual has its mean over the
        flight removed.
        """
        recording = self.recordings[index]
        r = recording.measured - self.predicted(index, theta_scaled)
        r[..., 5] = np.angle(np.exp(1j * r[..., 5]))
        return _in_body(recording, r)

    def residuals(self, theta_scaled: Annotated[np.ndarray, "parameters lanes"]) -> list[np.ndarray]:
        """Return the `residual` (lanes, bins, 12) of each flight."""
        return self.each(lambda index: self.residual(index, theta_scaled))

    def slopes(
        self,
        theta_scaled: Annotated[np.ndarray, "parameters"],
        effects: Sequence[str],
        base: Sequence[np.ndarray],
        *,
        afresh: bool = False,
    ) -> Slopes:
        """Return the derivatives of the prediction of each flight with respect to theta_scaled.

        They are the negative derivatives of the residual, measured minus predicted.

        The first call computes the slopes of all parameters and caches them. Later calls update only the
        slopes of `effects` and of effects with states of their own. The slopes of the other effects hardly
        change while these stay within their tolerance: the length of a payload's line, for example, has no
        influence without a payload.

        Parameters
        ----------
        theta_scaled
            Scaled parameters.
        effects
            Effects whose slopes are computed again.
        base
            Residual (bins, 12) of each flight at theta_scaled.
        afresh
            Whether to compute all slopes again.
        """
        updated = {i for name in effects for i in self.space.groups[name]} | self._products
        rows = [i for i in self._rows if afresh or self._slopes is None or i in updated]
        lanes = np.repeat(theta_scaled[:, None], len(rows), axis=1)
        for lane, row in enumerate(rows):
            lanes[row, lane] += _THETA_STEP

        def perturbed(index: int) -> tuple[np.ndarray, np.ndarray]:
            """Return the slopes of a flight, and the squares of its perturbed residuals."""
            r = self.residual(index, lanes) if rows else np.empty((0, *base[index].shape))
            return ((base[index] - r) / _THETA_STEP).astype(np.float32), np.square(r).sum((1, 2))

        slopes, squares = zip(*self.each(perturbed), strict=True)
        sizes = np.zeros(1 + len(theta_scaled))
        sizes[0] = sum(float(np.square(r).sum()) for r in base)
        sizes[[1 + row for row in rows]] = np.sum(squares, axis=0)
        self.space.check_finite(sizes)
        whole = len(rows) == len(self._rows)
        result = Slopes(
            parameters=len(theta_scaled), rows=rows, latest=slopes, earlier=None if whole else self._slopes
        )
        if whole:
            self._slopes = result
        return result


def _drive(states: States, stages: np.ndarray) -> np.ndarray:
    """Return the drive (n, 23) of phi at times (n,) in s since the start of the reference.

    After its end the reference is held.
    """
    return reference_drive(
        states.reference,
        stages,
        feedforward=states.feedforward,
        voltage_ratio=np.interp(stages, states.t_s, states.voltage_ratio),
    )


def _means(recording: Recording, samples: np.ndarray, latency_s: np.ndarray) -> np.ndarray:
    """Return bin means (lanes, bins, 12) of states (n, 19, lanes).

    Poses are delayed by `latency_s` (lanes,) against their stamps. Body rates are means over each bin; rate
    integrals are values in the middle of each bin.
    """
    lanes, bins = samples.shape[2], recording.bins
    out = np.empty((lanes, bins, CHANNELS))
    for late in np.unique(latency_s):
        mine = latency_s == late
        poses = samples[:, (0, 1, 2, 6, 7, 8)][:, :, mine].reshape(len(samples), -1)
        mean = _pose_means(recording, float(late), len(samples)) @ poses
        out[mine, :, :6] = mean.reshape(bins, 6, -1).transpose(2, 0, 1)
    for channels, columns, telemetry in (
        (slice(6, 9), slice(9, 12), recording.rates),
        (slice(9, CHANNELS), INTEGRAL, recording.integrals),
    ):
        mean = telemetry @ samples[:, columns].reshape(len(samples), -1)
        out[:, :, channels] = mean.reshape(bins, 3, lanes).transpose(2, 0, 1)
    return out


def _pose_means(recording: Recording, latency_s: float, count: int) -> csr_array:
    """Return the matrix (bins, count) that maps `count` samples to the mean over the poses of each bin.

    Samples are SAMPLE_S apart. Each pose shows the state `latency_s` before its stamp.
    """
    poses = np.maximum(np.bincount(recording.pose_bin, minlength=recording.bins), 1)
    each = (1.0 / poses[recording.pose_bin], (recording.pose_bin, np.arange(len(recording.pose_bin))))
    mean = csr_array(each, shape=(recording.bins, len(recording.pose_bin)))
    return mean @ interpolation(recording.pose_s - latency_s, count)


def _in_body(recording: Recording, r: np.ndarray) -> np.ndarray:
    """Return differences r (lanes, bins, 12) with position in the heading frame and attitude in FRD.

    The mean body-rate difference over the flight is removed, since it is the bias of the gyro.
    """
    out = np.empty_like(r)
    c, s = np.cos(recording.measured[:, 5]), np.sin(recording.measured[:, 5])
    out[..., 0] = c * r[..., 0] + s * r[..., 1]
    out[..., 1] = c * r[..., 1] - s * r[..., 0]
    out[..., 2] = r[..., 2]
    roll, pitch = recording.measured[:, 3], recording.measured[:, 4]
    out[..., 3] = r[..., 3] - np.sin(pitch) * r[..., 5]
    out[..., 4] = np.cos(roll) * r[..., 4] + np.sin(roll) * np.cos(pitch) * r[..., 5]
    out[..., 5] = np.cos(roll) * np.cos(pitch) * r[..., 5] - np.sin(roll) * r[..., 4]
    out[..., 6:9] = r[..., 6:9] - r[..., recording.known, 6:9].mean(-2, keepdims=True)
    out[..., 9:] = r[..., 9:]
    return out


def closed_loop(
    flights: Sequence[FlightData],
    vehicle: Vehicle,
    space: ParameterSpace,
    theta_scaled: Annotated[np.ndarray, "parameters"],
    *,
    jobs: int = 1,
) -> ClosedLoop:
    """Return the closed-loop model of `flights`, whose logs all hold a reference and the control law.

    theta_scaled: scaled parameters that give the pose latency. jobs: threads that predict flights. Raises
    TooLittleData if a log lacks a required topic.
    """
    values = space.by_owner(list(space.values(theta_scaled)))
    latency_s = float(latency_of(NUMPY, [(space.effects[name], values[name]) for name in space.parts]))
    states = flight_states([data.flight for data in flights], latency_s=latency_s)
    recordings = parallel.each(lambda pair: record(*pair), zip(flights, states, strict=True), jobs)
    return ClosedLoop(recordings, vehicle, space, jobs=jobs)


def tracking_time_and_extent(flights: Sequence[FlightData]) -> tuple[float, float]:
    """Return the tracking time of all flights in s, and the greatest extent of one along a NED axis in m."""
    spans = [data.signals for data in flights]
    return sum(s.span_s[1] - s.span_s[0] for s in spans), max(_extent(s) for s in spans)


def _extent(s: Signals) -> float:
    inside = (s.pose_s >= s.span_s[0]) & (s.pose_s <= s.span_s[1])
    return float(np.ptp(s.p_ned[inside], axis=0).max())


def order_of(loop: ClosedLoop) -> int:
    """Return the order of the autoregression that the known bins of these flights determine."""
    return affordable(sum(int(mask.sum()) for mask in loop.known))
