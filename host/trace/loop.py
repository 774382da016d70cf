"""Whole flights over the closed loop: what of them is compared, and phi's roll-outs beside it.

Nothing measured drives the model: the reference does, through the law. Poses, body rate and rate integral are
compared in bins, as telemetry shows them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from trimtab.host.codegen.ops import NUMPY
from trimtab.host.log import Flight
from trimtab.host.models.dynamics import mocap_latency_s as latency_of
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.states import States, flight_states
from trimtab.host.trace.parameters import Space
from trimtab.host.trace.signals import Signals, signals
from trimtab.host.trace.whitening import CHANNELS, affordable
from trimtab.host.vehicle import Vehicle

STEP_S = 0.02
PER_BIN = 2
BIN_S = PER_BIN * STEP_S
STABLE = 2.5
"""|eigenvalue| times step that RK4 stays stable at; what is that fast need not be exact here."""

LEAD_S = 0.3
"""Time after the reference's start that is not compared: the start's own errors die away in it."""

_Z_STEP = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A flight's means over `bins` of BIN_S, from the reference's start; of the integral the bins' middles.

    states: for its start, law and constants. pose_s (m,) s, of the pose's stamp, and pose_bin (m,). measured
    (bins, 12): p NED, Theta, body rate and rate integral FRD; known (bins,) where all were. rates, integrals
    (bins, samples): what telemetry makes of states sampled every STEP_S; a gyro's mean goes over whole
    intervals and the integral evenly from one frame to the next, as far apart as lost frames leave them.
    """

    states: States
    pose_s: np.ndarray
    pose_bin: np.ndarray
    measured: np.ndarray
    known: np.ndarray
    rates: csr_array
    integrals: csr_array

    @property
    def bins(self) -> int:
        """How many bins."""
        return len(self.measured)


def record(flight: Flight, states: States) -> Recording:
    """The recording of a flight with reference, law and telemetry, and its `states`."""
    s = signals(flight)
    start = s.span_s[0]
    duration = min(states.reference.nodes[-1].t_us * 1e-6, s.span_s[1] - start)
    bins = int(duration / BIN_S)
    t = s.pose_s - start
    inside = (t >= 0.0) & (t < bins * BIN_S)
    pose_bin = (t[inside] / BIN_S).astype(int)
    angles = _euler(s.R[inside])
    poses = np.column_stack([s.p[inside], angles])
    count = np.bincount(pose_bin, minlength=bins)
    sums = np.column_stack([np.bincount(pose_bin, column, minlength=bins) for column in poses.T])
    samples = bins * PER_BIN + 1
    shares = _shares(BIN_S * np.arange(bins + 1), s.imu_s - start)
    covered = shares.sum(1)
    shares = shares.multiply(1.0 / np.maximum(covered, 1e-9)[:, None]).tocsr()
    assert flight.control is not None
    frames_s = flight.control.sensed_us[:, 1] * 1e-6 - start
    between = _between_frames(BIN_S * (np.arange(bins) + 0.5), frames_s)
    late = BIN_S * (np.arange(bins) + 0.5) < LEAD_S
    return Recording(
        states=states,
        pose_s=t[inside],
        pose_bin=pose_bin,
        measured=np.column_stack(
            [
                sums / np.maximum(count, 1)[:, None],
                shares @ s.gyro,
                between @ flight.control.rate_integral,
            ]
        ),
        known=(count > 0) & (covered > 0.5 * BIN_S) & ~late,
        rates=shares @ _interval_means(s.imu_s - start, samples),
        integrals=between @ _interpolation(frames_s, samples),
    )


def _shares(edges_s: np.ndarray, interval_s: np.ndarray) -> csr_array:
    """(n, m): time in s that each of m intervals (m, 2), in order, has in each of n bins between edges."""
    cuts = np.unique(np.clip(np.concatenate([edges_s, interval_s.ravel()]), edges_s[0], edges_s[-1]))
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    owner = np.maximum(np.searchsorted(interval_s[:, 0], middle, side="right") - 1, 0)
    inside = (middle > interval_s[owner, 0]) & (middle < interval_s[owner, 1])
    rows = np.searchsorted(edges_s, middle[inside], side="right") - 1
    shape = (len(edges_s) - 1, len(interval_s))
    return csr_array((np.diff(cuts)[inside], (rows, owner[inside])), shape=shape)


def _interval_means(interval_s: np.ndarray, samples: int) -> csr_array:
    """(m, samples): means over intervals (m, 2) of what samples every STEP_S show, by Simpson's rule."""
    length = np.diff(interval_s, axis=1)[:, 0]
    parts = np.maximum(np.ceil(length / STEP_S - 1e-6), 1.0).astype(int)
    owner = np.repeat(np.arange(len(interval_s)), parts)
    part = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    nodes = part[:, None] + np.array([0.0, 0.5, 1.0])
    at = interval_s[owner, :1] + nodes * (length / parts)[owner, None]
    weights = np.array([1.0, 4.0, 1.0]) / 6.0 / parts[owner, None]
    rule = csr_array(
        (weights.ravel(), (np.repeat(owner, 3), np.arange(weights.size))),
        shape=(len(interval_s), weights.size),
    )
    return rule @ _interpolation(at.ravel(), samples)


def _between_frames(at_s: np.ndarray, frames_s: np.ndarray) -> csr_array:
    """(n, m): linear interpolation at n times between m frames; at the ends the last frame's value."""
    k = np.clip(np.searchsorted(frames_s, at_s, side="right") - 1, 0, len(frames_s) - 2)
    u = np.clip((at_s - frames_s[k]) / np.maximum(frames_s[k + 1] - frames_s[k], 1e-9), 0.0, 1.0)
    rows = np.repeat(np.arange(len(at_s)), 2)
    columns = np.column_stack([k, k + 1]).ravel()
    weights = np.column_stack([1.0 - u, u]).ravel()
    return csr_array((weights, (rows, columns)), shape=(len(at_s), len(frames_s)))


def _interpolation(t_s: np.ndarray, samples: int) -> csr_array:
    """(n, samples): what samples every STEP_S show at times (n,), by the cubic through four of them."""
    t = np.clip(t_s / STEP_S, 0.0, samples - 1.0)
    k = np.clip(t.astype(int), 1, samples - 3)
    u = t - k
    weights = np.column_stack(
        [
            -u * (u - 1.0) * (u - 2.0) / 6.0,
            (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
            -(u + 1.0) * u * (u - 2.0) / 2.0,
            (u + 1.0) * u * (u - 1.0) / 6.0,
        ]
    )
    rows = np.repeat(np.arange(len(t)), 4)
    columns = (k[:, None] + np.arange(-1, 3)).ravel()
    return csr_array((weights.ravel(), (rows, columns)), shape=(len(t), samples))


def _euler(R: np.ndarray) -> np.ndarray:
    """Theta (n, 3) of R_ned_frd (n, 3, 3), yaw unwrapped."""
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    pitch = -np.arcsin(np.clip(R[:, 2, 0], -1.0, 1.0))
    return np.column_stack([roll, pitch, np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Alike:
    """Flights of one firmware setting: their indices, phi in `fine` steps to STEP_S, and what drives it."""

    flights: tuple[int, ...]
    phi: Phi
    fine: int
    x0: np.ndarray
    drive: np.ndarray
    constants: np.ndarray


class Loop:
    """phi with a space's effects over recordings: residuals and their slopes."""

    def __init__(self, recordings: Sequence[Recording], vehicle: Vehicle, space: Space) -> None:
        self.recordings, self.space = tuple(recordings), space
        self._rows = [i for name in space.parts for i in space.owners[name]]
        self._products = {i for name in space.parts if space.effects[name].memory for i in space.owners[name]}
        self._slopes: list[np.ndarray] = []
        effects = tuple(space.effects[name] for name in space.parts)
        settings: dict[tuple[tuple[str, float], ...], list[int]] = {}
        for index, recording in enumerate(recordings):
            settings.setdefault(tuple(sorted((recording.states.parameters or {}).items())), []).append(index)
        self._alike: list[_Alike] = []
        for flights in settings.values():
            chosen = [recordings[index] for index in flights]
            phi = Phi(vehicle=vehicle, effects=effects, parameters=chosen[0].states.parameters)
            fine = max(1, math.ceil(phi.stiffness * STEP_S / STABLE))
            steps = max(recording.bins for recording in chosen) * PER_BIN * fine
            stages = half_steps(0.0, steps, STEP_S / fine)
            drives = [_drive(recording.states, stages) for recording in chosen]
            self._alike.append(
                _Alike(
                    flights=tuple(flights),
                    phi=phi,
                    fine=fine,
                    x0=np.stack([recording.states.initial(phi) for recording in chosen], axis=1),
                    drive=np.stack(drives).transpose(1, 2, 0),
                    constants=np.stack([recording.states.constants for recording in chosen], axis=1),
                )
            )

    @property
    def known(self) -> list[np.ndarray]:
        """Per flight (bins,) where everything was measured."""
        return [recording.known for recording in self.recordings]

    def predicted(self, z: np.ndarray) -> list[np.ndarray]:
        """Per flight the means (lanes, bins, 12) as measured, for scaled parameters z (P, lanes)."""
        lanes = z.shape[1]
        theta = self.space.values(z)[self._rows]
        parts = [self._alike[0].phi.parts(theta[:, lane]) for lane in range(lanes)]
        latency_s = np.array([float(latency_of(NUMPY, each)) for each in parts])
        found: dict[int, np.ndarray] = {}
        for alike in self._alike:
            count = len(alike.flights)
            samples = roll_out(
                alike.phi,
                x0=np.repeat(alike.x0, lanes, axis=1),
                drive=alike.drive,
                flight=alike.constants,
                theta=np.tile(theta, (1, count)),
                step_s=STEP_S / alike.fine,
                every=alike.fine,
                lane_flight=np.repeat(np.arange(count), lanes),
                rows=INTEGRAL.stop,
                compiled=True,
            ).reshape(-1, INTEGRAL.stop, count, lanes)
            for k, index in enumerate(alike.flights):
                recording = self.recordings[index]
                own = samples[: recording.bins * PER_BIN + 1, :, k]
                found[index] = _means(recording, own, latency_s)
        return [found[index] for index in range(len(self.recordings))]

    def residuals(self, z: np.ndarray) -> list[np.ndarray]:
        """Per flight measured minus predicted (lanes, bins, 12) for z (P, lanes); the rate less its mean."""
        out = []
        for recording, predicted in zip(self.recordings, self.predicted(z), strict=True):
            r = recording.measured - predicted
            r[..., 5] = np.angle(np.exp(1j * r[..., 5]))
            out.append(_in_body(recording, r))
        return out

    def slopes(
        self, z: np.ndarray, effects: Sequence[str], base: Sequence[np.ndarray], *, afresh: bool = False
    ) -> list[np.ndarray]:
        """Per flight the negative slopes (P, bins, 12) at z (P,) of the residual, which is `base` (bins, 12).

        The first call computes all slopes, and any one `afresh`; others those of `effects` and of effects
        with states of their own, for what else stays within its tolerance hardly changes them: a payload's
        line does nothing where there is no payload.
        """
        chosen = {i for name in effects for i in self.space.groups[name]} | self._products
        rows = [i for i in self._rows if afresh or not self._slopes or i in chosen]
        lanes = np.repeat(z[:, None], len(rows), axis=1)
        for lane, row in enumerate(rows):
            lanes[row, lane] += _Z_STEP
        pushed = self.residuals(lanes) if rows else [np.empty((0, *r.shape)) for r in base]
        if not self._slopes:
            self._slopes = [np.zeros((len(z), *r.shape)) for r in base]
        slopes = [kept.copy() for kept in self._slopes]
        sizes = np.zeros(1 + len(z))
        sizes[0] = sum(float(np.square(r).sum()) for r in base)
        sizes[[1 + row for row in rows]] = sum(np.square(r).sum((1, 2)) for r in pushed)
        self.space.check_finite(sizes)
        for each, r, away in zip(slopes, base, pushed, strict=True):
            each[rows] = (r - away) / _Z_STEP
        if len(rows) == len(self._rows):
            self._slopes = slopes
        return slopes


def _drive(states: States, stages: np.ndarray) -> np.ndarray:
    """(n, 22): what drives phi at times (n,) since the reference's start, which is held at its end."""
    return reference_drive(
        states.reference,
        stages,
        feedforward=states.feedforward,
        voltage_ratio=np.interp(stages, states.t_s, states.voltage_ratio),
    )


def _means(recording: Recording, samples: np.ndarray, latency_s: np.ndarray) -> np.ndarray:
    """(lanes, bins, 12) of states (n, 19, lanes): poses as stamped, `latency_s` (lanes,) old; mean rates;
    integrals in the middle of each bin.
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
    """(bins, count): means over each bin's poses of what samples every STEP_S show `latency_s` earlier."""
    poses = np.maximum(np.bincount(recording.pose_bin, minlength=recording.bins), 1)
    each = (1.0 / poses[recording.pose_bin], (recording.pose_bin, np.arange(len(recording.pose_bin))))
    mean = csr_array(each, shape=(recording.bins, len(recording.pose_bin)))
    return mean @ _interpolation(recording.pose_s - latency_s, count)


def _in_body(recording: Recording, r: np.ndarray) -> np.ndarray:
    """Differences (lanes, bins, 12) as measured, with position along the heading and the turn in FRD.

    The rate loses its mean over the flight: the gyro's bias.
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


def closed_loop(flights: Sequence[Flight], vehicle: Vehicle, space: Space, z: np.ndarray) -> Loop:
    """The closed loop of `flights`, all with reference and law; poses are as late as z (P,) says.

    Raises TooLittleData where a log lacks something.
    """
    values = space.theta(list(space.values(z)))
    latency_s = float(latency_of(NUMPY, [(space.effects[name], values[name]) for name in space.parts]))
    states = flight_states(flights, latency_s=latency_s)
    return Loop([record(*each) for each in zip(flights, states, strict=True)], vehicle, space)


def tracking_extent(flights: Sequence[Flight]) -> tuple[float, float]:
    """Return the tracking time of all flights in s, and the greatest extent of one along an axis in m."""
    spans = [signals(flight) for flight in flights]
    return sum(s.span_s[1] - s.span_s[0] for s in spans), max(_extent(s) for s in spans)


def _extent(s: Signals) -> float:
    inside = (s.pose_s >= s.span_s[0]) & (s.pose_s <= s.span_s[1])
    return float(np.ptp(s.p[inside], axis=0).max())


def order_of(loop: Loop) -> int:
    """The order of the autoregression that these flights have enough bins for."""
    return affordable(sum(int(whole.sum()) for whole in loop.known))
