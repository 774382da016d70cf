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
"""|eigenvalue| times step that RK4 stays stable at; what is that fast need not be exact here."""

_Z_STEP = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class _Alike:
    """Flights of one firmware setting: their indices, phi in `fine` steps to SAMPLE_S, and what drives it."""

    flights: tuple[int, ...]
    phi: Phi
    fine: int
    x0: np.ndarray
    drive: np.ndarray
    constants: np.ndarray


class Loop:
    """phi with a space's effects over recordings: residuals and their slopes."""

    def __init__(self, recordings: Sequence[Recording], vehicle: Vehicle, space: ParameterSpace) -> None:
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
            fine = max(1, math.ceil(phi.stiffness * SAMPLE_S / STABLE))
            steps = max(recording.bins for recording in chosen) * PER_BIN * fine
            stages = half_steps(0.0, steps, SAMPLE_S / fine)
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

    def predicted(self, theta_scaled: np.ndarray) -> list[np.ndarray]:
        """Return per flight the means (lanes, bins, 12) as measured, for theta_scaled (P, lanes)."""
        lanes = theta_scaled.shape[1]
        theta = self.space.values(theta_scaled)[self._rows]
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
                step_s=SAMPLE_S / alike.fine,
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

    def residuals(self, theta_scaled: np.ndarray) -> list[np.ndarray]:
        """Return per flight measured minus predicted (lanes, bins, 12) for theta_scaled (P, lanes).

        The body rate is less its mean.
        """
        out = []
        for recording, predicted in zip(self.recordings, self.predicted(theta_scaled), strict=True):
            r = recording.measured - predicted
            r[..., 5] = np.angle(np.exp(1j * r[..., 5]))
            out.append(_in_body(recording, r))
        return out

    def slopes(
        self,
        theta_scaled: np.ndarray,
        effects: Sequence[str],
        base: Sequence[np.ndarray],
        *,
        afresh: bool = False,
    ) -> list[np.ndarray]:
        """Return per flight the negative slopes (P, bins, 12) of the residual at theta_scaled (P,).

        `base` is the residual there, per flight (bins, 12).

        The first call computes all slopes, and any one `afresh`; others those of `effects` and of effects
        with states of their own, for what else stays within its tolerance hardly changes them: a payload's
        line does nothing where there is no payload.
        """
        chosen = {i for name in effects for i in self.space.groups[name]} | self._products
        rows = [i for i in self._rows if afresh or not self._slopes or i in chosen]
        lanes = np.repeat(theta_scaled[:, None], len(rows), axis=1)
        for lane, row in enumerate(rows):
            lanes[row, lane] += _Z_STEP
        pushed = self.residuals(lanes) if rows else [np.empty((0, *r.shape)) for r in base]
        if not self._slopes:
            self._slopes = [np.zeros((len(theta_scaled), *r.shape)) for r in base]
        slopes = [kept.copy() for kept in self._slopes]
        sizes = np.zeros(1 + len(theta_scaled))
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
    """(bins, count): means over each bin's poses of what samples every SAMPLE_S show `latency_s` earlier."""
    poses = np.maximum(np.bincount(recording.pose_bin, minlength=recording.bins), 1)
    each = (1.0 / poses[recording.pose_bin], (recording.pose_bin, np.arange(len(recording.pose_bin))))
    mean = csr_array(each, shape=(recording.bins, len(recording.pose_bin)))
    return mean @ interpolation(recording.pose_s - latency_s, count)


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


def closed_loop(
    flights: Sequence[FlightData], vehicle: Vehicle, space: ParameterSpace, theta_scaled: np.ndarray
) -> Loop:
    """Return the closed loop of `flights`, all with reference and law; poses are as late as theta_scaled
    (P,) says.

    Raises TooLittleData where a log lacks something.
    """
    values = space.theta(list(space.values(theta_scaled)))
    latency_s = float(latency_of(NUMPY, [(space.effects[name], values[name]) for name in space.parts]))
    states = flight_states([data.flight for data in flights], latency_s=latency_s)
    return Loop([record(*each) for each in zip(flights, states, strict=True)], vehicle, space)


def tracking_extent(flights: Sequence[FlightData]) -> tuple[float, float]:
    """Return the tracking time of all flights in s, and the greatest extent of one along an axis in m."""
    spans = [data.signals for data in flights]
    return sum(s.span_s[1] - s.span_s[0] for s in spans), max(_extent(s) for s in spans)


def _extent(s: Signals) -> float:
    inside = (s.pose_s >= s.span_s[0]) & (s.pose_s <= s.span_s[1])
    return float(np.ptp(s.p_ned[inside], axis=0).max())


def order_of(loop: Loop) -> int:
    """Return the order of the autoregression that these flights have enough bins for."""
    return affordable(sum(int(whole.sum()) for whole in loop.known))
