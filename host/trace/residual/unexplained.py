"""Abstention: what the chosen effects leave behind, judged by flights of the same reference and by its
spectrum.

Twin flights share the world and nothing else. What of the estimated disturbance repeats between them is
therefore physics the model lacks, whatever its size beside the turbulence, and its power needs no noise
floor: mean of w_1 . w_2. Twins cannot see a disturbance of random phase; a line in the spectrum can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc, gammainccinv

from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.decision.rules import RULES, Rules

_FFT = 256


@dataclass(frozen=True, kw_only=True)
class SpectralLine:
    """The strongest line of a residual's spectrum.

    ratio: its power over the median around it. chance: probability that noise alone shows one as strong.
    rms: its amplitude, in the unit of the residual.
    """

    ratio: float = 1.0
    hz: float = 0.0
    chance: float = 1.0
    rms: float = 0.0


NO_LINE = SpectralLine()


@dataclass(frozen=True, kw_only=True)
class ChannelResidual:
    """What a residual force (m/s^2) or torque (rad/s^2) holds beside turbulence.

    repeat: rms that repeats between twin flights, negative where it reverses. z_score: its score, of unit
    variance where nothing repeats. line: the strongest line of its spectrum.
    """

    repeat: float
    z_score: float
    line: SpectralLine


@dataclass(frozen=True, kw_only=True)
class FlightRepeat:
    """What repeats between twins of whole flights less their prediction.

    share: its power over that of turbulence and noise, both whitened; negative where it reverses. z_score: of
    unit variance where nothing repeats. position_m: rms of the position that repeats. size: number
    of whitened values of either twin that were compared.
    """

    share: float
    z_score: float
    position_m: float
    size: int = 0

    @property
    def amplitude(self) -> float:
        """Return its amplitude over that of turbulence and noise."""
        return float(np.sqrt(max(self.share, 0.0)))

    def lower_share(self, rules: Rules) -> float:
        """Return the share `repeat_standard_errors` down, 0 where nothing repeats."""
        if self.z_score <= rules.repeat_z:
            return 0.0
        return self.share * (1.0 - rules.repeat_standard_errors / self.z_score)

    def log_evidence(self, rules: Rules) -> float:
        """Return the log evidence in nats that a model without fault would gain, 0 where nothing repeats."""
        return 0.5 * self.size * self.share if self.z_score > rules.repeat_z else 0.0


@dataclass(frozen=True, kw_only=True)
class UnexplainedResidual:
    """What a model leaves of the flights that turbulence and noise do not explain.

    pairs: number of pairs of twin flights. flights: what whole flights repeat over the closed loop; None
    where none were compared. Then `flights` says whether something repeats, and the channels say what.
    """

    force: ChannelResidual
    torque: ChannelResidual
    pairs: int
    flights: FlightRepeat | None = None


def unexplained_residual(
    w: np.ndarray, data: Segments, twins: Sequence[tuple[int, int]], *, axial: bool = True
) -> UnexplainedResidual:
    """Return repeatability and spectrum of disturbances w (segments, bins, 6); twins pair flight indices.

    Twin segments match by their start since tracking began. Where the measured body rate drives the attitude,
    the last three channels are gyro errors: they say nothing of torque. Without `axial`, force along the
    thrust is left out: where the thrust is unknown, it holds what was commanded.
    """
    flight, start_s = data.flight, data.start_s
    per_bin = data.steps // w.shape[1]
    speed = np.gradient(data.p_ned, data.dt_s, axis=1)
    turned = data.rate_frd if data.rate_weight.any() else speed
    motions = [each.reshape(len(w), w.shape[1], per_bin, 3).mean(2) for each in (speed, turned)]
    channels = (slice(0, 3 if axial else 2), slice(3, 6))
    residuals = []
    for channel, motion, silent in zip(channels, motions, (False, data.rate_driven), strict=True):
        repeat, z = _repeat(w[:, :, channel], flight, start_s, twins)
        line = NO_LINE if silent else _line(w[:, :, channel], motion, flight, start_s)
        residuals.append(ChannelResidual(repeat=repeat, z_score=z, line=line))
    force, torque = residuals
    return UnexplainedResidual(force=force, torque=torque, pairs=len(twins))


def _repeat(
    w: np.ndarray, flight: np.ndarray, start_s: np.ndarray, twins: Sequence[tuple[int, int]]
) -> tuple[float, float]:
    """Return the rms of w (segments, bins, 3) that repeats between twins, negative where it reverses, and
    its z score.

    Without repetition the product of two segments has a mean of 0 and a variance in proportion to their
    powers; how great, segments of twins at different times of the reference say.
    """
    power = (w**2).sum((1, 2))
    product, variance, cosine_squares = [0.0], [0.0], []
    bins = 0
    for a, b in twins:
        mine, other = np.flatnonzero(flight == a), np.flatnonzero(flight == b)
        if not len(mine) or not len(other):
            continue
        products = np.einsum("icj,kcj->ik", w[mine], w[other])
        powers = np.maximum(np.outer(power[mine], power[other]), 1e-300)
        matched = np.round(start_s[mine] / BIN_S)[:, None] == np.round(start_s[other] / BIN_S)
        product.append(products[matched].sum())
        variance.append(powers[matched].sum())
        cosine_squares.append((products**2 / powers)[~matched])
        bins += int(matched.sum()) * w.shape[1]
    if not bins or not sum(len(c) for c in cosine_squares):
        return 0.0, 0.0
    total = float(sum(product))
    spread = float(np.sqrt(sum(variance) * np.concatenate(cosine_squares).mean()))
    return float(np.sign(total) * np.sqrt(abs(total) / bins)), total / spread if spread > 0 else 0.0


def _line(w: np.ndarray, motion: np.ndarray, flight: np.ndarray, start_s: np.ndarray) -> SpectralLine:
    """Return the strongest line of w (segments, bins, 3).

    Channels count by their own median power. Frequencies at which the vehicle itself was made to move, seen
    in `motion` (segments, bins, 3: velocity for a force, body rate for a torque), are left out: there any
    force that depends on the motion has a line.
    The chance is that of so great a ratio anywhere in the band without a line.
    """
    hz = np.fft.rfftfreq(_FFT, BIN_S)
    power, moved, series = np.zeros(len(hz)), np.zeros(len(hz)), 0
    squares, windows = np.zeros(len(hz)), 0
    for f in np.unique(flight):
        mine = np.flatnonzero(flight == f)
        mine = mine[np.argsort(start_s[mine])]
        # A segment's edges know less than its middle: a constant force would have a line at its length.
        for window in _windows(w[mine] - w[mine].mean(0), start_s[mine]):
            found = _periodogram(window)
            squares += 2.0 * found.sum(1) / np.hanning(len(window)).sum() ** 2
            windows += 1
            for each in found.T:
                power += each / max(float(np.median(each)), 1e-300)
                series += 1
        for window in _windows(motion[mine], start_s[mine]):
            moved += _periodogram(window).sum(1)
    around = np.array([np.median(power[max(0, k - 14) : k + 15]) for k in range(len(power))])
    quiet = moved <= RULES.excited_power_share * moved.max()
    inside = (hz > RULES.line_min_hz) & (hz < RULES.line_max_hz) & quiet
    band = np.flatnonzero(inside)
    if not len(band):
        return NO_LINE
    ratio = power[band] / np.maximum(around[band], 1e-300)
    best = int(ratio.argmax())
    # Sums of `series` exponentials are gamma distributed.
    chance = len(band) * float(gammaincc(series, ratio[best] * gammainccinv(series, 0.5)))
    rms = float(np.sqrt(squares[band][best] / windows))
    return SpectralLine(ratio=float(ratio[best]), hz=float(hz[band][best]), chance=min(1.0, chance), rms=rms)


def _windows(x: np.ndarray, start_s: np.ndarray) -> list[np.ndarray]:
    """Segments (segments, bins, 3) in order as unbroken series (n, 3) of up to _FFT bins.

    A segment that was left out ends a series. One much shorter than the flight's longest tells little of slow
    lines and is passed over.
    """
    bins = x.shape[1]
    breaks = np.flatnonzero(np.abs(np.diff(start_s) - bins * BIN_S) > 0.5 * BIN_S) + 1
    runs = [run.reshape(-1, x.shape[2]) for run in np.split(x, breaks)]
    cut = [run[k : k + _FFT] for run in runs for k in range(0, len(run), _FFT)]
    longest = max(len(run) for run in cut)
    return [run for run in cut if 2 * len(run) > longest]


def _periodogram(series: np.ndarray) -> np.ndarray:
    """Power (frequencies, 3) of a series (n, 3) of bins, tapered."""
    tapered = (series - series.mean(0)) * np.hanning(len(series))[:, None]
    return np.abs(np.fft.rfft(tapered, _FFT, axis=0)) ** 2
