"""The unexplained residual of a set of effects: its repeatability between flights and its spectrum.

Repeat flights share only the vehicle, its surroundings and the reference. The part of the estimated
disturbance that repeats between them is therefore physics that the model lacks, however small it is next to
the turbulence. The mean of w_1 . w_2, the scalar product of the disturbances of two repeat flights, is not
biased by noise, so no noise floor is subtracted. An oscillation whose phase differs between flights does not
repeat, but shows as a line in the spectrum. Nor does a force that comes back every few seconds, such as that
of a fan that sweeps. Its pulses show in the difference of two repeat flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import gammaincc, gammainccinv

from trimtab.host.trace.data.segments import BIN_S, Segments
from trimtab.host.trace.decision.rules import RULES, Rules

_FFT = 256
"""Length in bins of the Fourier transform."""

_PULSE_BINS = 5
"""Length in bins of a pulse."""
_PHASE_S = 0.4
"""Shift after which noise, averaged over a pulse, is independent."""
_BEST = 3.5
"""Standard deviations by which the best direction and interval may exceed the mean."""
_DIRECTIONS = 18
"""Horizontal directions that are tried, over half a turn."""


@dataclass(frozen=True, kw_only=True)
class SpectralLine:
    """The strongest line in the spectrum of a residual.

    ratio: its power over the median power of neighbouring frequencies. hz: its frequency. chance: probability
    that noise alone shows a line of this ratio. rms: its root mean square, in the unit of the residual.
    """

    ratio: float = 1.0
    hz: float = 0.0
    chance: float = 1.0
    rms: float = 0.0


NO_LINE = SpectralLine()


@dataclass(frozen=True, kw_only=True)
class PulseTrain:
    """The strongest pulses of force at equal intervals, in one horizontal direction.

    ratio: mean pulse over the greatest one that noise of the same power may show. period_s: interval.
    peak_m_s2: mean pulse, averaged over half a second. bearing_rad: where it pushes, from north to east.
    """

    ratio: float = 0.0
    period_s: float = 0.0
    peak_m_s2: float = 0.0
    bearing_rad: float = 0.0


NO_PULSES = PulseTrain()


@dataclass(frozen=True, kw_only=True)
class ChannelResidual:
    """The residual specific force (m/s^2) or angular acceleration (rad/s^2) beyond turbulence.

    repeat: rms that repeats between repeat flights, negative if the two flights are anticorrelated. z_score:
    the z score of `repeat`, of unit variance if nothing repeats. line: strongest line of the spectrum.
    """

    repeat: float
    z_score: float
    line: SpectralLine


@dataclass(frozen=True, kw_only=True)
class FlightRepeat:
    """The part of the prediction errors of whole flights that repeats between repeat flights.

    share: its power over the power of turbulence and noise, both whitened; negative if the two flights are
    anticorrelated. z_score: the z score of `share`, of unit variance if nothing repeats. position_m: rms of
    the position error that repeats. size: number of whitened values compared, counted in one flight of each
    pair.
    """

    share: float
    z_score: float
    position_m: float
    size: int = 0

    @property
    def amplitude(self) -> float:
        """Amplitude of the repeatable part over that of turbulence and noise."""
        return float(np.sqrt(max(self.share, 0.0)))

    def lower_share(self, rules: Rules) -> float:
        """Return `share` minus RULES.repeat_standard_errors standard errors; 0 if nothing repeats."""
        if self.z_score <= rules.repeat_z:
            return 0.0
        return self.share * (1.0 - rules.repeat_standard_errors / self.z_score)

    def attainable_nats(self, rules: Rules) -> float:
        """Return the nats of log evidence that a perfect model would gain; 0 if nothing repeats."""
        return 0.5 * self.size * self.share if self.z_score > rules.repeat_z else 0.0


@dataclass(frozen=True, kw_only=True)
class UnexplainedResidual:
    """The part of a model's residual that turbulence and noise do not explain.

    Attributes
    ----------
    force, torque
        Residual disturbance of segments.
    pairs
        Number of pairs of repeat flights.
    pulses
        Pulses of the force that do not repeat between repeat flights.
    flight_repeat
        Repeatability of whole flights in closed loop; None if none were compared. If present, it decides
        whether something repeats, and `force` and `torque` only show what.
    """

    force: ChannelResidual
    torque: ChannelResidual
    pairs: int
    pulses: PulseTrain = NO_PULSES
    flight_repeat: FlightRepeat | None = None


_QUIET = ChannelResidual(repeat=0.0, z_score=0.0, line=NO_LINE)
NOTHING_UNEXPLAINED = UnexplainedResidual(force=_QUIET, torque=_QUIET, pairs=0)
"""The residual where none was computed."""


def unexplained_residual(
    w: Annotated[np.ndarray, "segments bins 6"],
    data: Segments,
    repeat_flights: Sequence[tuple[int, int]],
    *,
    axial: bool = True,
) -> UnexplainedResidual:
    """Return the repeatability and the spectrum of a disturbance.

    Segments of repeat flights match if they start at the same time since tracking began.

    Parameters
    ----------
    w
        Disturbance, FRD: specific force in m/s^2, then angular acceleration in rad/s^2.
        If the measured body rate drives the attitude, the last three components are gyro errors; their
        spectrum is not searched.
    data
        Segments of the disturbance.
    repeat_flights
        Pairs of indices of repeat flights.
    axial
        Whether to include the force along the thrust. If the thrust is unknown, that force contains the
        commanded thrust.
    """
    flight, start_s = data.flight, data.start_s
    per_bin = data.steps // w.shape[1]
    speed = np.gradient(data.p_ned, data.dt_s, axis=1)
    rotation = data.rate_frd if data.rate_weight.any() else speed
    motions = [each.reshape(len(w), w.shape[1], per_bin, 3).mean(2) for each in (speed, rotation)]
    channels = (slice(0, 3 if axial else 2), slice(3, 6))
    residuals = []
    for channel, motion, skip_line in zip(channels, motions, (False, data.rate_driven), strict=True):
        repeat, z = _repeat(w[:, :, channel], flight, start_s, repeat_flights)
        line = NO_LINE if skip_line else _line(w[:, :, channel], motion, flight, start_s)
        residuals.append(ChannelResidual(repeat=repeat, z_score=z, line=line))
    force, torque = residuals
    frd = w[:, :, :3] if axial else w[:, :, :3] * [1.0, 1.0, 0.0]
    R = data.R_ned_frd.reshape(len(w), w.shape[1], per_bin, 3, 3)[:, :, per_bin // 2, :2]
    horizontal = np.einsum("sbij,sbj->sbi", R, frd)
    pulses = _pulses(horizontal, flight, start_s, repeat_flights)
    return UnexplainedResidual(force=force, torque=torque, pairs=len(repeat_flights), pulses=pulses)


def _repeat(
    w: np.ndarray, flight: np.ndarray, start_s: np.ndarray, repeat_flights: Sequence[tuple[int, int]]
) -> tuple[float, float]:
    """Return the rms of w (segments, bins, 3) that repeats, and its z score.

    The rms is negative if the two flights are anticorrelated.

    If nothing repeats, the product of two segments has mean 0 and a variance proportional to the product of
    their powers. Segments of repeat flights at different times of the reference give the constant of
    proportionality.
    """
    power = (w**2).sum((1, 2))
    product, variance, cosine_squares = [0.0], [0.0], []
    bins = 0
    for a, b in repeat_flights:
        first, second = np.flatnonzero(flight == a), np.flatnonzero(flight == b)
        if not len(first) or not len(second):
            continue
        products = np.einsum("icj,kcj->ik", w[first], w[second])
        powers = np.maximum(np.outer(power[first], power[second]), 1e-300)
        matched = np.round(start_s[first] / BIN_S)[:, None] == np.round(start_s[second] / BIN_S)
        product.append(products[matched].sum())
        variance.append(powers[matched].sum())
        cosine_squares.append((products**2 / powers)[~matched])
        bins += int(matched.sum()) * w.shape[1]
    if not bins or not sum(len(c) for c in cosine_squares):
        return 0.0, 0.0
    total = float(sum(product))
    spread = float(np.sqrt(sum(variance) * np.concatenate(cosine_squares).mean()))
    return float(np.sign(total) * np.sqrt(abs(total) / bins)), total / spread if spread > 0 else 0.0


def _pulses(
    force: Annotated[np.ndarray, "segments bins 2"],
    flight: Annotated[np.ndarray, "segments"],
    start_s: Annotated[np.ndarray, "segments"],
    repeat_flights: Sequence[tuple[int, int]],
) -> PulseTrain:
    """Return the strongest pulses of a horizontal force (north, east) at equal intervals.

    In the difference of two repeat flights, pulses of the first are positive and those of the second are
    negative. What repeats is not in it. For each direction and interval, the difference is averaged over
    equidistant times, and the span of these averages over all phases is the size of the pulses.

    The greatest of M averages of n values of noise is sqrt(2 ln M / n) of its standard deviations, and the
    span varies by about sqrt(0.5 / n). The best direction and interval may exceed the mean span of all pairs
    by _BEST standard deviations.
    """
    bearing = np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
    towards = np.stack([np.cos(bearing), np.sin(bearing)])
    periods = np.arange(round(RULES.pulse_min_s / BIN_S), round(RULES.pulse_max_s / BIN_S) + 1)
    size, by_chance = np.zeros((len(periods), _DIRECTIONS)), np.zeros(len(periods))
    variance, pairs = np.zeros(len(periods)), np.zeros(len(periods))
    power, cubes, count = np.zeros(_DIRECTIONS), np.zeros(_DIRECTIONS), 0
    for first, second in repeat_flights:
        masks = [flight == first, flight == second]
        if not all(mask.any() for mask in masks):
            continue
        both = [_series(force[mask], start_s[mask]) for mask in masks]
        begin = max(k for k, _ in both)
        a, b = (x[begin - k :] @ towards for k, x in both)
        length = min(len(a), len(b))
        smooth = [
            uniform_filter1d(x[:length] - x[:length].mean(0), _PULSE_BINS, axis=0, mode="constant")
            for x in (a, b)
        ]
        cubes += sum((x**3).sum(0) for x in smooth)
        difference = smooth[0] - smooth[1]
        power += (difference**2).sum(0)
        count += length
        for row, period in enumerate(periods.tolist()):
            turns = length // period
            if turns < 2:
                continue
            means = difference[: turns * period].reshape(turns, period, -1).mean(0)
            size[row] += means.max(0) - means.min(0)
            by_chance[row] += 2.0 * np.sqrt(2.0 * np.log(period * BIN_S / _PHASE_S) / turns)
            variance[row] += 0.5 / turns
            pairs[row] += 1
    if not by_chance.any():
        return NO_PULSES
    by_chance += _BEST * np.sqrt(variance)
    ratio = size / np.maximum(by_chance[:, None] * np.sqrt(power / count), 1e-300)
    row = int(ratio.max(1).argmax())
    column = int(size[row].argmax())
    return PulseTrain(
        ratio=float(ratio[row].max()),
        period_s=float(periods[row] * BIN_S),
        peak_m_s2=float(size[row, column] / (2.0 * pairs[row])),
        bearing_rad=float(bearing[column] + (np.pi if cubes[column] < 0.0 else 0.0)),
    )


def _series(
    force: Annotated[np.ndarray, "segments bins 2"], start_s: Annotated[np.ndarray, "segments"]
) -> tuple[int, Annotated[np.ndarray, "n 2"]]:
    """Return the bin at which a flight's segments begin, and their force bin by bin; 0 in gaps."""
    at = np.round(start_s / BIN_S).astype(int)
    x = np.zeros((int(at.max() - at.min()) + force.shape[1], 2))
    for k, segment in zip(at - at.min(), force, strict=True):
        x[k : k + len(segment)] = segment
    return int(at.min()), x


def _line(w: np.ndarray, motion: np.ndarray, flight: np.ndarray, start_s: np.ndarray) -> SpectralLine:
    """Return the strongest line in the spectrum of w (segments, bins, 3).

    The spectrum of each channel is divided by its median. Frequencies that the motion excites are left
    out, since any force that depends on the motion has a line there. `motion` (segments, bins, 3) shows them:
    the velocity for a force, the body rate for a torque. `SpectralLine.chance` is the probability of such a
    ratio anywhere in the band if there is no line.
    """
    hz = np.fft.rfftfreq(_FFT, BIN_S)
    power, motion_power, series = np.zeros(len(hz)), np.zeros(len(hz)), 0
    squares, windows = np.zeros(len(hz)), 0
    for f in np.unique(flight):
        order = np.flatnonzero(flight == f)
        order = order[np.argsort(start_s[order])]
        # The disturbance is less certain at the edges of a segment than in its middle, so a constant force
        # would show a line at the period of the segments. Subtracting the mean segment removes it.
        for window in _windows(w[order] - w[order].mean(0), start_s[order]):
            spectrum = _periodogram(window)
            squares += 2.0 * spectrum.sum(1) / np.hanning(len(window)).sum() ** 2
            windows += 1
            for channel in spectrum.T:
                power += channel / max(float(np.median(channel)), 1e-300)
                series += 1
        for window in _windows(motion[order], start_s[order]):
            motion_power += _periodogram(window).sum(1)
    background = np.array([np.median(power[max(0, k - 14) : k + 15]) for k in range(len(power))])
    not_excited = motion_power <= RULES.excited_power_share * motion_power.max()
    inside = (hz > RULES.line_min_hz) & (hz < RULES.line_max_hz) & not_excited
    band = np.flatnonzero(inside)
    if not len(band):
        return NO_LINE
    ratio = power[band] / np.maximum(background[band], 1e-300)
    best = int(ratio.argmax())
    # Under noise, a power is a sum of `series` exponential variables, which is gamma distributed.
    chance = len(band) * float(gammaincc(series, ratio[best] * gammainccinv(series, 0.5)))
    rms = float(np.sqrt(squares[band][best] / windows))
    return SpectralLine(ratio=float(ratio[best]), hz=float(hz[band][best]), chance=min(1.0, chance), rms=rms)


def _windows(x: np.ndarray, start_s: np.ndarray) -> list[np.ndarray]:
    """Return segments x (segments, bins, 3), sorted by time, as unbroken series (n, 3) of up to _FFT bins.

    A left-out segment ends a series. Series of at most half the length of the longest one are dropped, since
    they resolve slow lines badly.
    """
    bins = x.shape[1]
    breaks = np.flatnonzero(np.abs(np.diff(start_s) - bins * BIN_S) > 0.5 * BIN_S) + 1
    runs = [run.reshape(-1, x.shape[2]) for run in np.split(x, breaks)]
    windows = [run[k : k + _FFT] for run in runs for k in range(0, len(run), _FFT)]
    longest = max(len(window) for window in windows)
    return [window for window in windows if 2 * len(window) > longest]


def _periodogram(series: np.ndarray) -> np.ndarray:
    """Return the power spectrum (frequencies, 3) of a series (n, 3), tapered by a Hann window."""
    tapered = (series - series.mean(0)) * np.hanning(len(series))[:, None]
    return np.abs(np.fft.rfft(tapered, _FFT, axis=0)) ** 2
