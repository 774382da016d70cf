"""Abstention: what the chosen effects leave behind, judged by flights of the same reference and by its
spectrum.

Twin flights share the world and nothing else. What of the estimated disturbance repeats between them is
therefore physics the model lacks, whatever its size beside the turbulence, and its power needs no noise
floor: mean of w_1 . w_2. Twins cannot see a disturbance of random phase; a line in the spectrum can.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import gammaincc, gammainccinv

from trimtab.host.trace.segments import BIN_S, Segments

REPEAT_Z = 3.0
FORCE_FLOOR = 0.06
"""Specific force, m/s^2, below which what repeats or rings is not worth a name (the turbulence's level)."""

TORQUE_FLOOR = 0.8
"""The same for angular acceleration, rad/s^2."""

FORM_SHARE = 0.1
"""Share of what was explained that may repeat besides: no form is exact."""

LINE_RATIO = 3.5
SWINGING_LINE_RATIO = 10.0
"""The same beside an effect that swings by itself: a little of its swing is always left."""

LINE_CHANCE = 1e-3
"""A line counts when noise alone would show one as strong less often than this."""

MOVED_SHARE = 0.02
"""Share of the motion's strongest frequency from which on the vehicle was made to move at a frequency."""

REPEAT_SHARE = 0.08
"""Power of whole flights that repeats, over turbulence's and noise's, below which it is not worth a name; it
counts two standard errors down. One twin of a quick route leaves 0.14 +- 0.03 without anything missing.
"""

REPEAT_FORM = 0.2
"""Amplitude that may repeat besides, over that of a model without any effect: no form is exact."""

WORSENED, WORSENED_M = 1.5, 0.01
"""Effects with which so much more of the position repeats than without any, and so much in m, explain
nothing.
"""

NO_LINE = (1.0, 0.0, 1.0, 0.0)
_OF_A_LINE = ("", "_hz", "_chance", "_rms")
_LINE_BAND_HZ = (0.3, 4.0)
_FFT = 256


@dataclass(frozen=True, kw_only=True)
class Repeat:
    """What repeats of whole flights less their prediction.

    share: its power over that of turbulence and noise, both whitened; negative where it reverses. z: its
    score, of unit variance where nothing repeats. position_m: rms of the position that repeats. size: how
    many whitened numbers of either twin were compared.
    """

    share: float
    z: float
    position_m: float
    size: int = 0

    @property
    def least(self) -> float:
        """The share that it has at least, two standard errors down."""
        return self.share * (1.0 - 2.0 / self.z) if self.z > REPEAT_Z else 0.0

    @property
    def nats(self) -> float:
        """Log evidence that something repeats: what a model without fault would gain."""
        return 0.5 * self.size * self.share if self.z > REPEAT_Z else 0.0

    @property
    def amplitude(self) -> float:
        """Its amplitude over that of turbulence and noise."""
        return float(np.sqrt(max(self.share, 0.0)))


@dataclass(frozen=True, kw_only=True)
class Leftover:
    """What repeats or rings in the residual disturbance: rms that repeats, its z score, and the strongest
    line.

    Where `whole` flights were compared over the closed loop, it is they that say whether something repeats,
    and the disturbance what.
    """

    force_repeat: float
    force_z: float
    force_line: float
    force_line_hz: float
    force_line_chance: float
    force_line_rms: float
    torque_repeat: float
    torque_z: float
    torque_line: float
    torque_line_hz: float
    torque_line_chance: float
    torque_line_rms: float
    pairs: int
    force_floor: float = FORCE_FLOOR
    torque_floor: float = TORQUE_FLOOR
    line_floor: float = LINE_RATIO
    whole: Repeat | None = None
    whole_floor: float = REPEAT_SHARE
    position_ceiling_m: float = np.inf

    def beside(self, missing: Leftover, *, swinging: bool = False) -> Leftover:
        """The same, its floors raised to FORM_SHARE of what a model without any effect leaves, `missing`, of
        which it has to be an improvement.

        `swinging`: an effect with states of its own was found.
        """
        return replace(
            self,
            force_floor=max(self.force_floor, FORM_SHARE * missing.force_repeat),
            torque_floor=max(self.torque_floor, FORM_SHARE * missing.torque_repeat),
            line_floor=SWINGING_LINE_RATIO if swinging else self.line_floor,
            whole_floor=max(
                self.whole_floor,
                REPEAT_FORM**2 * missing.whole.share if missing.whole is not None else 0.0,
            ),
            position_ceiling_m=(
                max(WORSENED_M, WORSENED * missing.whole.position_m) if missing.whole else np.inf
            ),
        )

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the residual cannot be the library's, one sentence each; empty when nothing stands out."""
        out = []
        if self.whole is not None and self.whole.least > self.whole_floor:
            out.append(
                f"{1e3 * self.whole.position_m:.1f} mm of whole flights' error repeat between twin flights, "
                f"{self.whole.amplitude:.1f} times turbulence and noise (z {self.whole.z:.1f})"
            )
        if self.whole is not None and self.whole.position_m > self.position_ceiling_m:
            out.append(
                f"{1e3 * self.whole.position_m:.1f} mm of whole flights' error repeat with the effects that "
                f"fit best, less than {1e3 * self.position_ceiling_m:.1f} mm without any"
            )
        if self.whole is None or out:
            out += self._repeating()
        out += self._ringing()
        return tuple(out)

    def _repeating(self) -> list[str]:
        out = []
        if self.force_z > REPEAT_Z and self.force_repeat > self.force_floor:
            out.append(
                f"a force of {self.force_repeat:.2f} m/s^2 repeats between twin flights "
                f"(z {self.force_z:.1f})"
            )
        if self.torque_z > REPEAT_Z and self.torque_repeat > self.torque_floor:
            out.append(
                f"an angular acceleration of {self.torque_repeat:.2f} rad/s^2 repeats between twin flights "
                f"(z {self.torque_z:.1f})"
            )
        return out

    def _ringing(self) -> list[str]:
        out = []
        force = self.force_line, self.force_line_hz, self.force_line_chance, self.force_line_rms
        torque = self.torque_line, self.torque_line_hz, self.torque_line_chance, self.torque_line_rms
        for name, (line, hz, chance, rms), floor in (
            ("force", force, self.force_floor),
            ("torque", torque, self.torque_floor),
        ):
            if line > self.line_floor and chance < LINE_CHANCE and rms > floor:
                out.append(f"the residual {name} rings at {hz:.2f} Hz, {line:.1f} times its surroundings")
        return out


def leftover(
    w: np.ndarray, data: Segments, twins: Sequence[tuple[int, int]], *, axial: bool = True
) -> Leftover:
    """Repeatability and spectrum of disturbances w (segments, bins, 6); twins pair flight indices.

    Twin segments match by their start since tracking began. Where the measured body rate drives the attitude,
    the last three channels are gyro errors: they say nothing of torque. Without `axial`, force along the
    thrust is left out: where the thrust is unknown, it holds what was commanded.
    """
    flight, start_s = data.flight, data.start_s
    per_bin = data.steps // w.shape[1]
    speed = np.gradient(data.position, data.dt_s, axis=1)
    turned = data.rate if data.rate_weight.any() else speed
    motions = [each.reshape(len(w), w.shape[1], per_bin, 3).mean(2) for each in (speed, turned)]
    found: dict[str, Any] = {}
    channels = (slice(0, 3 if axial else 2), slice(3, 6))
    for name, channel, motion in zip(("force", "torque"), channels, motions, strict=True):
        found[f"{name}_repeat"], found[f"{name}_z"] = _repeat(w[:, :, channel], flight, start_s, twins)
        silent = name == "torque" and data.rate_driven
        line = NO_LINE if silent else _line(w[:, :, channel], motion, flight, start_s)
        found |= {f"{name}_line{of}": value for of, value in zip(_OF_A_LINE, line, strict=True)}
    return Leftover(pairs=len(twins), **found)


def _repeat(
    w: np.ndarray, flight: np.ndarray, start_s: np.ndarray, twins: Sequence[tuple[int, int]]
) -> tuple[float, float]:
    """The rms of w (segments, bins, 3) that repeats between twins, negative where it reverses, and its z
    score.

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


def _line(
    w: np.ndarray, motion: np.ndarray, flight: np.ndarray, start_s: np.ndarray
) -> tuple[float, float, float, float]:
    """The strongest line of w (segments, bins, 3): ratio over the median around it, frequency in Hz, chance,
    rms.

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
    inside = (hz > _LINE_BAND_HZ[0]) & (hz < _LINE_BAND_HZ[1]) & (moved <= MOVED_SHARE * moved.max())
    band = np.flatnonzero(inside)
    if not len(band):
        return NO_LINE
    ratio = power[band] / np.maximum(around[band], 1e-300)
    best = int(ratio.argmax())
    # Sums of `series` exponentials are gamma distributed.
    chance = len(band) * float(gammaincc(series, ratio[best] * gammainccinv(series, 0.5)))
    rms = float(np.sqrt(squares[band][best] / windows))
    return float(ratio[best]), float(hz[band][best]), min(1.0, chance), rms


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
