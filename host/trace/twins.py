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

from host.trace.segments import BIN_S

REPEAT_Z = 3.0
FORCE_FLOOR = 0.06
"""Repeatable specific force, m/s^2, below which what repeats is not worth a name (the turbulence's level)."""

TORQUE_FLOOR = 0.8
"""The same for angular acceleration, rad/s^2."""

LINE_RATIO = 3.5
_LINE_BAND_HZ = (0.3, 4.0)
_FFT = 256


@dataclass(frozen=True, kw_only=True)
class Leftover:
    """What repeats or rings in the residual disturbance: rms that repeats, its z score, and the strongest
    line.
    """

    force_repeat: float
    force_z: float
    force_line: float
    force_line_hz: float
    torque_repeat: float
    torque_z: float
    torque_line: float
    torque_line_hz: float
    pairs: int

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the residual cannot be the library's, one sentence each; empty when nothing stands out."""
        out = []
        if self.force_z > REPEAT_Z and self.force_repeat > FORCE_FLOOR:
            out.append(
                f"a force of {self.force_repeat:.2f} m/s^2 repeats between twin flights "
                f"(z {self.force_z:.1f})"
            )
        if self.torque_z > REPEAT_Z and self.torque_repeat > TORQUE_FLOOR:
            out.append(
                f"an angular acceleration of {self.torque_repeat:.2f} rad/s^2 repeats between twin flights "
                f"(z {self.torque_z:.1f})"
            )
        for name, line, hz in (
            ("force", self.force_line, self.force_line_hz),
            ("torque", self.torque_line, self.torque_line_hz),
        ):
            if line > LINE_RATIO:
                out.append(f"the residual {name} rings at {hz:.2f} Hz, {line:.1f} times its surroundings")
        return tuple(out)


def leftover(
    w: np.ndarray, flight: np.ndarray, start_s: np.ndarray, twins: Sequence[tuple[int, int]]
) -> Leftover:
    """Repeatability and spectrum of disturbances w (segments, bins, 6) of flights; twins pair flight indices.

    start_s (segments,) is each segment's start since its flight's tracking began: twin segments match by it.
    """
    found: dict[str, float] = {}
    for name, channel in (("force", slice(0, 3)), ("torque", slice(3, 6))):
        products, count = [], 0
        for a, b in twins:
            for i, k in _matches(flight, start_s, a, b):
                products.append(float((w[i][:, channel] * w[k][:, channel]).sum()))
                count += w.shape[1]
        power = sum(products) / count if count else 0.0
        spread = float(np.sqrt(np.square(products).sum())) if products else 0.0
        found[f"{name}_repeat"] = float(np.sign(power) * np.sqrt(abs(power)))
        found[f"{name}_z"] = sum(products) / spread if spread > 0 else 0.0
        found[f"{name}_line"], found[f"{name}_line_hz"] = _line(w[:, :, channel], flight)
    return Leftover(pairs=len(twins), **found)


def _matches(flight: np.ndarray, start_s: np.ndarray, a: int, b: int) -> list[tuple[int, int]]:
    """Segment indices of flights a and b that begin at the same time of the reference."""
    of_b = {round(float(start_s[k]) / BIN_S): int(k) for k in np.flatnonzero(flight == b)}
    pairs = ((int(i), of_b.get(round(float(start_s[i]) / BIN_S))) for i in np.flatnonzero(flight == a))
    return [(i, k) for i, k in pairs if k is not None]


def _line(w: np.ndarray, flight: np.ndarray) -> tuple[float, float]:
    """Greatest ratio of the summed periodogram over the median around it, and its frequency in Hz."""
    power = np.zeros(_FFT // 2 + 1)
    for f in np.unique(flight):
        series = w[flight == f].reshape(-1, w.shape[2])[:_FFT]
        tapered = (series - series.mean(0)) * np.hanning(len(series))[:, None]
        power += (np.abs(np.fft.rfft(tapered, _FFT, axis=0)) ** 2).sum(1)
    hz = np.fft.rfftfreq(_FFT, BIN_S)
    around = np.array([np.median(power[max(0, k - 14) : k + 15]) for k in range(len(power))])
    band = np.flatnonzero((hz > _LINE_BAND_HZ[0]) & (hz < _LINE_BAND_HZ[1]))
    ratio = power[band] / np.maximum(around[band], 1e-300)
    best = int(ratio.argmax())
    return float(ratio[best]), float(hz[band][best])
