"""Roll-outs of whole flights in closed loop, and their residuals.

The closed-loop model phi is driven by the reference through the control law, not by measurements. Poses, body
rate and rate integral are compared as means over bins, as telemetry records them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypeVar

import numpy as np

from trimtab.firmware_model.law.step import integral_limit
from trimtab.host.base import parallel
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.slots import mocap_latency_s as latency_of
from trimtab.host.models.states import States
from trimtab.host.trace.data.signals import FlightData, Signals, pose_interval_s, states_of
from trimtab.host.trace.flight_fit.recording import PER_BIN, SAMPLE_S, Recording, limited_share, record
from trimtab.host.trace.flight_fit.rotors import RotorSpeeds
from trimtab.host.trace.flight_fit.whitening import CHANNELS, affordable
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.vehicle import Vehicle

STABLE = 2.5
"""Greatest |eigenvalue| times step for which RK4 is stable. Modes this fast need not be accurate here."""

_TOGETHER = 8
"""Most flights that are rolled out together: they fill up to as many SIMD lanes with one parameter vector."""

Result = TypeVar("Result")

_THETA_STEP = 1e-4
"""Step of the difference quotients, scaled."""

_FAR = 0.5
"""Change of a strength, scaled, beyond which the slopes of all effects are computed again."""
_KEPT = 2
"""Points of which the slopes of all effects are kept: that of the latest fit, and that it started from."""
_NEAR = 0.1
"""Change of the strengths, scaled, up to which slopes count as those of a point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Batch:
    """Flights with the same firmware parameters that are rolled out together.

    flights: indices of recordings. fine: integration steps in SAMPLE_S. x0, drive, constants: inputs of
    `roll_out`, one column for each flight.
    """

    flights: tuple[int, ...]
    phi: Phi
    fine: int
    x0: Annotated[np.ndarray, "states flights"]
    drive: Annotated[np.ndarray, "stages 23 flights"]
    constants: Annotated[np.ndarray, "15 flights"]

    @classmethod
    def of(cls, phi: Phi, flights: Sequence[int], recordings: Sequence[Recording]) -> _Batch:
        """Return the batch of the flights with these indices. All recordings are given."""
        batch = [recordings[index] for index in flights]
        fine = max(1, math.ceil(phi.stiffness * SAMPLE_S / STABLE))
        steps = max(recording.bins for recording in batch) * PER_BIN * fine
        stages = half_steps(0.0, steps, SAMPLE_S / fine)
        return cls(
            flights=tuple(flights),
            phi=phi,
            fine=fine,
            x0=np.stack([recording.states.initial(phi) for recording in batch], axis=1),
            drive=np.stack([_drive(recording.states, stages) for recording in batch], axis=2),
            constants=np.stack([recording.states.constants for recording in batch], axis=1),
        )

    def samples(
        self, theta: Annotated[np.ndarray, "parameters lanes"], part: slice
    ) -> Annotated[np.ndarray, "samples 19 lanes"]:
        """Return the states of a part of the flights every SAMPLE_S, the lanes of one after the other."""
        x0, lanes = self.x0[:, part], theta.shape[1]
        count = x0.shape[1]
        samples = roll_out(
            self.phi,
            x0=np.repeat(x0, lanes, axis=1),
            drive=self.drive[:, :, part],
            flight=self.constants[:, part],
            theta=np.tile(theta, (1, count)),
            step_s=SAMPLE_S / self.fine,
            every=self.fine,
            lane_flight=np.repeat(np.arange(count), lanes),
            rows=INTEGRAL.stop,
            compiled=True,
        )
        limit = np.array(integral_limit(self.phi.firmware))[:, None]
        np.clip(samples[:, INTEGRAL], -limit, limit, out=samples[:, INTEGRAL])
        return samples


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
            slopes = np.zeros((self.parameters, *latest.shape[1:]), dtype=np.float32)
        else:
            slopes = self.earlier[index]
        slopes[self.rows] = latest
        return slopes


class ClosedLoop:
    """Closed-loop model phi with the effects of a parameter space, over recordings of whole flights.

    jobs: threads that predict flights. speeds: measured rotor speeds of the flights; None without any.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        vehicle: Vehicle,
        space: ParameterSpace,
        *,
        speeds: RotorSpeeds | None = None,
        jobs: int = 1,
    ) -> None:
        self.recordings, self.space, self.speeds, self.jobs = tuple(recordings), space, speeds, jobs
        self._rows = [i for name in space.parts for i in space.owners[name]]
        self._strengths = [i for i in self._rows if space.columns[i].strength and not space.columns[i].form]
        self._slopes: list[tuple[np.ndarray, Slopes]] = []  # of all effects, with their point; latest first
        effects = tuple(space.effects[name] for name in space.parts)
        settings: dict[tuple[tuple[str, float], ...], list[int]] = {}
        for index in sorted(range(len(recordings)), key=lambda index: recordings[index].bins):
            parameters = recordings[index].states.parameters or {}
            settings.setdefault(tuple(sorted(parameters.items())), []).append(index)
        self._batches: list[_Batch] = []
        for indices in settings.values():
            phi = Phi(vehicle=vehicle, effects=effects, parameters=recordings[indices[0]].states.parameters)
            size = min(max(1, math.ceil(len(indices) / jobs)), _TOGETHER)
            batches = [indices[k : k + size] for k in range(0, len(indices), size)]
            self._batches += [_Batch.of(phi, batch, recordings) for batch in batches]

    @property
    def known(self) -> list[np.ndarray]:
        """Masks (bins,), one for each flight, of the bins in which all channels were measured."""
        return [recording.known for recording in self.recordings]

    def each(self, work: Callable[[int], Result]) -> list[Result]:
        """Return `work` of the index of every flight."""
        return parallel.each(work, range(len(self.recordings)), self.jobs)

    def with_predictions(
        self,
        theta_scaled: Annotated[np.ndarray, "parameters lanes"],
        work: Callable[[int, np.ndarray], Result],
    ) -> list[Result]:
        """Return `work` of the index of each flight and its predicted bin means (lanes, bins, 12).

        The channels are those of `Recording.measured`.
        """
        lanes = theta_scaled.shape[1]
        theta = self.space.values(theta_scaled)[self._rows]
        latency = np.asarray(latency_of(NUMPY, self._batches[0].phi.parts(theta)))
        latency_s = np.broadcast_to(latency, (lanes,))

        together = _flights_together(lanes)

        def predict(batch: _Batch) -> list[tuple[int, Result]]:
            results = []
            for first in range(0, len(batch.flights), together):
                part = batch.flights[first : first + together]
                samples = batch.samples(theta, slice(first, first + together))
                for k, index in enumerate(part):
                    recording = self.recordings[index]
                    of_flight = samples[: recording.bins * PER_BIN + 1, :, k * lanes : (k + 1) * lanes]
                    results.append((index, work(index, _means(recording, of_flight, latency_s))))
            return results

        batches = parallel.each(predict, self._batches, self.jobs)
        results = dict(result for batch in batches for result in batch)
        return [results[index] for index in range(len(self.recordings))]

    def with_residuals(
        self,
        theta_scaled: Annotated[np.ndarray, "parameters lanes"],
        work: Callable[[int, np.ndarray], Result],
    ) -> list[Result]:
        """Return `work` of the index of each flight and its residual (lanes, bins, 12).

        The residual is measured minus predicted. Position is resolved along the heading, attitude in FRD. The
        body-rate residual has its mean over the flight removed.
        """

        def compare(index: int, predicted: np.ndarray) -> Result:
            recording = self.recordings[index]
            r = recording.measured - predicted
            r[..., 5] = np.angle(np.exp(1j * r[..., 5]))
            return work(index, _in_body(recording, r))

        return self.with_predictions(theta_scaled, compare)

    def residuals(self, theta_scaled: Annotated[np.ndarray, "parameters lanes"]) -> list[np.ndarray]:
        """Return the residual (lanes, bins, 12) of each flight."""
        return self.with_residuals(theta_scaled, lambda _, r: r)

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

        The first call computes the slopes of all parameters and caches them. Later calls near that point, or
        near the one before, update only the slopes of `effects`. The slopes of the other effects hardly
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
        space = self.space
        updated = {i for name in effects for i in (*space.groups[name], *space.forms[name])}
        near = self._nearest(theta_scaled)
        whole = afresh or near is None or self._change(theta_scaled, near[0]) > _FAR
        active = set(space.active(theta_scaled).tolist())
        rows = [i for i in self._rows if i in active and (whole or i in updated)]
        if whole:
            near = None
            del self._slopes[_KEPT - 1 :]  # before the next ones are made: of many flights they are large
        lanes = np.repeat(theta_scaled[:, None], len(rows), axis=1)
        for lane, row in enumerate(rows):
            lanes[row, lane] += _THETA_STEP

        def slopes_of(index: int, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return the slopes of a flight, and the squares of its perturbed residuals."""
            return ((base[index] - r) / _THETA_STEP).astype(np.float32), np.square(r).sum((1, 2))

        if rows:
            slopes, squares = zip(*self.with_residuals(lanes, slopes_of), strict=True)
        else:
            slopes, squares = [np.empty((0, *r.shape)) for r in base], np.zeros((1, 0))
        sizes = np.zeros(1 + len(theta_scaled))
        sizes[0] = sum(float(np.square(r).sum()) for r in base)
        sizes[[1 + row for row in rows]] = np.sum(squares, axis=0)
        self.space.check_finite(sizes)
        result = Slopes(
            parameters=len(theta_scaled), rows=rows, latest=slopes, earlier=None if near is None else near[1]
        )
        if whole:
            self._slopes.insert(0, (theta_scaled.copy(), result))
        return result

    def knows_slopes(self, theta_scaled: Annotated[np.ndarray, "parameters"]) -> bool:
        """Return whether the slopes of all effects were computed at theta_scaled, or close to it."""
        near = self._nearest(theta_scaled)
        return near is not None and self._change(theta_scaled, near[0]) <= _NEAR

    def _nearest(self, theta_scaled: np.ndarray) -> tuple[np.ndarray, Slopes] | None:
        """Return the nearest point at which the slopes of all effects are known, and these."""
        return min(self._slopes, key=lambda known: self._change(theta_scaled, known[0]), default=None)

    def _change(self, theta_scaled: np.ndarray, at: np.ndarray) -> float:
        """Return the greatest change of a strength between two points."""
        return float(np.abs(theta_scaled - at)[self._strengths].max(initial=0.0))


def _flights_together(lanes: int) -> int:
    """Return how many flights to roll out together: as few as fill nine tenths of the SIMD lanes.

    Few flights take little memory.
    """
    return next(n for n in range(1, _TOGETHER + 1) if 10 * (-n * lanes % _TOGETHER) <= n * lanes)


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
        mean = recording.poses @ (recording.at_poses(float(late), len(samples)) @ poses)
        out[mine, :, :6] = mean.reshape(bins, 6, -1).transpose(2, 0, 1)
    for channels, columns, telemetry in (
        (slice(6, 9), slice(9, 12), recording.rates),
        (slice(9, CHANNELS), INTEGRAL, recording.integrals),
    ):
        mean = telemetry @ samples[:, columns].reshape(len(samples), -1)
        out[:, :, channels] = mean.reshape(bins, 3, lanes).transpose(2, 0, 1)
    return out


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
    noise_free: bool = False,
) -> ClosedLoop:
    """Return the closed-loop model of `flights`, whose logs all hold a reference and the control law.

    theta_scaled: scaled parameters that give the pose latency. jobs: threads that predict flights.
    noise_free: whether the flights are without noise and turbulence, as predictions are. If not, and without
    measured rotor speeds, the space of the model is `space.of_predicted_flights()`. Raises TooLittleData if a
    log lacks a required topic.
    """
    values = space.by_owner(list(space.values(theta_scaled)))
    latency_s = float(latency_of(NUMPY, [(space.effects[name], values[name]) for name in space.parts]))
    states = states_of(flights, latency_s)
    recordings = parallel.each(lambda pair: record(*pair), zip(flights, states, strict=True), jobs)
    speeds = RotorSpeeds(flights, vehicle, space)
    if not speeds.present:
        shown = space if noise_free else space.of_predicted_flights()
        return ClosedLoop(recordings, vehicle, shown, jobs=jobs)
    return ClosedLoop(recordings, vehicle, space, speeds=speeds, jobs=jobs)


class Tracking(NamedTuple):
    """How much flights track.

    Attributes
    ----------
    tracking_s
        Tracking time of all flights with the rate integral inside its limits.
    extent_m
        Greatest extent of one of them along a NED axis.
    pose_interval_s
        Longest median interval between the poses of one of them.
    """

    tracking_s: float
    extent_m: float
    pose_interval_s: float


def amount_of_tracking(flights: Sequence[FlightData]) -> Tracking:
    """Return how much the flights track."""
    signals = [data.signals for data in flights]
    return Tracking(
        tracking_s=sum(
            (1.0 - limited_share(data)) * (s.span_s[1] - s.span_s[0])
            for data, s in zip(flights, signals, strict=True)
        ),
        extent_m=max(_extent(s) for s in signals),
        pose_interval_s=max(round(pose_interval_s(s), 6) for s in signals),  # stamps are whole microseconds
    )


def _extent(s: Signals) -> float:
    inside = (s.pose_s >= s.span_s[0]) & (s.pose_s <= s.span_s[1])
    return float(np.ptp(s.p_ned[inside], axis=0).max())


def order_of(loop: ClosedLoop) -> int:
    """Return the order of the autoregression that the known bins of these flights determine."""
    return affordable(loop.known)
