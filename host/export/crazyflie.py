"""Piecewise polynomials of degree 7 for the high-level commander of a Crazyflie.

The memory of the firmware holds 31 pieces of 132 bytes: a duration, and eight coefficients each for x, y, z
and yaw, in float32. x points north, y west, z up, and yaw is counterclockwise from above. Within a piece the
firmware evaluates the polynomials by Horner's rule in float32, from the time since the piece began.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.interpolate import BSpline

from trimtab.host.base.errors import Refused
from trimtab.host.export.samples import at_rate
from trimtab.protocol.blobs import Reference

PIECES_MAX = 31
"""Pieces in the 4096 bytes of the trajectory memory."""
POSITION_MAX_M, VELOCITY_MAX_M_S, YAW_MAX, YAW_RATE_MAX = 1e-3, 0.02, 0.01, 0.1
"""Greatest distances between the polynomials and the reference; the yaw in rad and rad/s."""
_DEGREE = 7
_RATE_HZ = 200.0
_ROUNDS = 8
_PULL = 0.3
_EVEN = 0.02
"""How often the edges of the pieces are moved towards where the error is; the power of a piece's error that
pulls them; the share of the greatest error that every piece counts at least. Found on shipped routes."""
_NORTH_WEST_UP = np.array([1.0, -1.0, -1.0])
HEADER = ("duration", *(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(_DEGREE + 1)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Polynomials:
    """A trajectory as the firmware holds it, and its greatest distance from the reference.

    durations_s and coefficients are float32; the latter are by piece, by x, y, z, yaw and by power. off: the
    errors of position, velocity, yaw and yaw rate at the samples, as shares of the allowed ones; the largest.
    """

    durations_s: Annotated[np.ndarray, "pieces"]
    coefficients: Annotated[np.ndarray, "pieces 4 8"]
    position_error_m: float
    velocity_error_m_s: float
    off: Annotated[np.ndarray, "samples"]

    def to_csv(self) -> str:
        """Return the table that tools for Crazyflies read; numbers read back to the same float32."""
        rows = [",".join(HEADER)]
        for duration, piece in zip(self.durations_s, self.coefficients, strict=True):
            rows.append(",".join(f"{value:.9g}" for value in (duration, *piece.reshape(-1))))
        return "\n".join(rows) + "\n"


def polynomials(reference: Reference, *, error_scale: float = 1.0) -> Polynomials:
    """Return the fewest pieces found within `error_scale` times the allowed errors, with C3 joints.

    Raises Refused with the errors that all 31 pieces leave, if they are greater.
    """
    held = at_rate(reference, _RATE_HZ)
    values = np.column_stack([held.p_ned * _NORTH_WEST_UP, -held.yaw])
    rates = np.column_stack([held.v_ned * _NORTH_WEST_UP, -held.yaw_rate])

    def fitted(pieces: int) -> Polynomials:
        edges = np.linspace(0.0, held.t_s[-1], pieces + 1)
        found: list[Polynomials] = []
        for _ in range(_ROUNDS):
            found.append(_fit(held.t_s, values, rates, edges))
            edges = _moved(held.t_s, found[-1].off, edges)
        return min(found, key=lambda each: each.off.max())

    low, high, best = 0, PIECES_MAX, fitted(PIECES_MAX)
    if best.off.max() > error_scale:
        raise Refused(
            f"{PIECES_MAX} pieces, all that a Crazyflie's memory holds, leave "
            f"{1e3 * best.position_error_m:.2g} mm, {best.velocity_error_m_s:.2g} m/s: {best.off.max():.3g} "
            "times the allowed errors; plan a shorter route, or allow more with --error-scale"
        )
    while high - low > 1:
        middle = (low + high) // 2
        found = fitted(middle)
        if found.off.max() <= error_scale:
            high, best = middle, found
        else:
            low = middle
    return best


def _fit(
    t_s: Annotated[np.ndarray, "samples"],
    values: Annotated[np.ndarray, "samples 4"],
    rates: Annotated[np.ndarray, "samples 4"],
    edges: Annotated[np.ndarray, "edges"],
) -> Polynomials:
    """Return the least-squares spline with these edges, rounded and compared as the firmware has it."""
    knots = np.concatenate([[edges[0]] * 4, np.repeat(edges, 4), [edges[-1]] * 4])
    basis = BSpline(knots, np.eye(len(knots) - _DEGREE - 1), _DEGREE)
    rows = np.vstack([basis(t_s) / POSITION_MAX_M, basis(t_s, nu=1) / VELOCITY_MAX_M_S])
    found = np.linalg.lstsq(rows, np.vstack([values / POSITION_MAX_M, rates / VELOCITY_MAX_M_S]))[0]
    spline = BSpline(knots, found, _DEGREE)
    taylor = [spline(edges[:-1], nu=k) / math.factorial(k) for k in range(_DEGREE + 1)]
    coefficients = np.stack(taylor, axis=2).astype(np.float32)
    durations_s = np.diff(edges).astype(np.float32)
    p, v = evaluate(durations_s, coefficients, t_s)
    p_off, v_off = (np.linalg.norm(off[:, :3], axis=1) for off in (p - values, v - rates))
    yaw_off, yaw_rate_off = np.abs(p - values)[:, 3], np.abs(v - rates)[:, 3]
    shares = (
        p_off / POSITION_MAX_M,
        v_off / VELOCITY_MAX_M_S,
        yaw_off / YAW_MAX,
        yaw_rate_off / YAW_RATE_MAX,
    )
    return Polynomials(
        durations_s=durations_s,
        coefficients=coefficients,
        position_error_m=float(p_off.max()),
        velocity_error_m_s=float(v_off.max()),
        off=np.max(shares, axis=0),
    )


def _moved(
    t_s: Annotated[np.ndarray, "samples"],
    off: Annotated[np.ndarray, "samples"],
    edges: Annotated[np.ndarray, "edges"],
) -> Annotated[np.ndarray, "edges"]:
    """Return edges between which the errors have more equal shares: closer where they are large."""
    piece = np.clip(np.searchsorted(edges, t_s, side="right") - 1, 0, len(edges) - 2)
    worst = np.array([off[piece == k].max(initial=0.0) for k in range(len(edges) - 1)])
    weights = (worst + _EVEN * worst.max() + 1e-9) ** _PULL
    share = np.concatenate([[0.0], np.cumsum(weights)])
    return np.interp(np.linspace(0.0, share[-1], len(edges)), share, edges)


def evaluate(
    durations_s: Annotated[np.ndarray, "pieces"],
    coefficients: Annotated[np.ndarray, "pieces 4 8"],
    t_s: Annotated[np.ndarray, "times"],
) -> tuple[Annotated[np.ndarray, "times 4"], Annotated[np.ndarray, "times 4"]]:
    """Return x, y, z, yaw and their rates by the firmware's arithmetic, in float32.

    As in the firmware, a piece begins when the durations before it, subtracted one by one, are over.
    """
    left = t_s.astype(np.float32)
    piece = np.zeros(len(t_s), dtype=int)
    for k, duration in enumerate(durations_s[:-1]):
        over = (piece == k) & (left > duration)
        left = np.where(over, left - duration, left)
        piece[over] = k + 1
    chosen = coefficients[piece]
    powers = np.arange(1, _DEGREE + 1, dtype=np.float32)
    return _horner(chosen, left), _horner(chosen[:, :, 1:] * powers, left)


def _horner(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    out = np.zeros(coefficients.shape[:2], dtype=np.float32)
    for k in reversed(range(coefficients.shape[2])):
        out = out * t[:, None] + coefficients[:, :, k]
    return out
