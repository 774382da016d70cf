"""Segments reduced flight by flight to what the evidence needs, and the variances of their disturbance.

`trimtab.host.trace.evidence` describes the model and the symbols.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, TypeVar

import numpy as np

from trimtab.host.base import parallel
from trimtab.host.trace.decision.rules import RULES

Result = TypeVar("Result")

OwnGrams = list[tuple[int, np.ndarray]]
"""Indices of pieces, and sums of Grams of [r | S | L] over segments of them."""


@dataclass(frozen=True, kw_only=True)
class DisturbanceVariances:
    """Log variances of the process disturbance, FRD.

    log_lateral, log_axial: specific force across and along the thrust, (m/s^2)^2. They differ because thrust
    errors act along the thrust. log_torque: angular acceleration, (rad/s^2)^2. In rate-driven mode (torque
    unknown; the measured body rate replaces the torque model) it is a body-rate error, (rad/s)^2.
    """

    log_lateral: float
    log_axial: float
    log_torque: float

    def sigma(self) -> Annotated[np.ndarray, "6"]:
        """Return standard deviations of the disturbance, FRD: force x, y, z, torque x, y, z."""
        logs = [self.log_lateral] * 2 + [self.log_axial] + [self.log_torque] * 3
        return np.exp(0.5 * np.array(logs))

    def covariance(self, bins: int) -> Annotated[np.ndarray, "disturbances disturbances"]:
        """Return the covariance of the disturbance, ordered by bin, then component."""
        return np.kron(correlation(bins), np.diag(self.sigma() ** 2))


def correlation(bins: int) -> Annotated[np.ndarray, "bins bins"]:
    """Return the correlation of the disturbance between bins."""
    lag = np.abs(np.subtract.outer(np.arange(bins), np.arange(bins)))
    return RULES.disturbance_correlation**lag


def innovation_root(bins: int) -> Annotated[np.ndarray, "disturbances innovations"]:
    """Return the matrix that makes the disturbance, in units of sigma, of its independent innovations."""
    return np.kron(np.linalg.cholesky(correlation(bins)), np.eye(6))


@dataclass(frozen=True, kw_only=True)
class Linearisation:
    """Grams of all segments at one point, with initial states projected out.

    Attributes
    ----------
    own
        Sum of the Grams of [r | S | L] over each piece, which is a flight or a part of one.
    square, cross
        Grams Z' Z and Z' [r | S | L] of the innovations, six for each bin. They are independent, so their
        covariance is diagonal for every process.
    piece
        Index of the piece of each segment.
    piece_flight
        Index of the flight of each piece.
    theta_scaled
        Scaled parameters.
    nuisances
        Sensor and flight errors that are constant over a flight.
    freedom
        Number of measured values, less the components of the initial states.
    variance_factor
        Variance of the sensor noise over that which the sensors state; the Grams are divided by it.
    jobs
        Threads that work on flights.
    """

    own: Annotated[np.ndarray, "pieces columns columns"]
    square: Annotated[np.ndarray, "segments innovations innovations"]
    cross: Annotated[np.ndarray, "segments innovations columns"]
    piece: Annotated[np.ndarray, "segments"]
    piece_flight: Annotated[np.ndarray, "pieces"]
    theta_scaled: Annotated[np.ndarray, "parameters"]
    nuisances: Annotated[np.ndarray, "flights nuisances"]
    freedom: int = 0
    variance_factor: float = 1.0
    jobs: int = 1

    @classmethod
    def blank(
        cls,
        bins: int,
        *,
        piece: Annotated[np.ndarray, "segments"],
        piece_flight: Annotated[np.ndarray, "pieces"],
        theta_scaled: Annotated[np.ndarray, "parameters"],
        nuisances: Annotated[np.ndarray, "flights nuisances"],
        freedom: int = 0,
        jobs: int = 1,
    ) -> Linearisation:
        """Return a linearisation to be filled: `reduce` sets the Grams of segments, `add` those of pieces."""
        columns, innovations = 1 + len(theta_scaled) + nuisances.shape[1], 6 * bins
        return cls(
            own=np.zeros((len(piece_flight), columns, columns)),
            square=np.empty((len(piece), innovations, innovations)),
            cross=np.empty((len(piece), innovations, columns)),
            piece=piece,
            piece_flight=piece_flight,
            theta_scaled=theta_scaled,
            nuisances=nuisances,
            freedom=freedom,
            jobs=jobs,
        )

    def with_variance_factor(self, factor: float) -> Linearisation:
        """Return the linearisation with this variance of the sensor noise over the stated one."""
        if factor == self.variance_factor:
            return self
        scale = self.variance_factor / factor
        return replace(
            self,
            own=scale * self.own,
            square=scale * self.square,
            cross=scale * self.cross,
            variance_factor=factor,
        )

    def reduce(
        self,
        segments: Annotated[np.ndarray, "part"],
        gram: Annotated[np.ndarray, "part all_columns all_columns"],
    ) -> OwnGrams:
        """Set the Grams of some segments from those of [r | S | L | Z]; return those to `add`.

        Threads may reduce different segments at the same time.
        """
        columns, root, piece = self.own.shape[1], innovation_root(self.bins), self.piece[segments]
        self.square[segments] = root.T @ gram[:, columns:, columns:] @ root
        self.cross[segments] = root.T @ gram[:, columns:, :columns]
        return [(each, gram[piece == each, :columns, :columns].sum(0)) for each in np.unique(piece).tolist()]

    def add(self, own: OwnGrams) -> None:
        """Add Grams of [r | S | L] to those of their pieces. The order of calls is that of the sums."""
        for piece, gram in own:
            self.own[piece] += gram

    @property
    def parameters(self) -> int:
        """Number of scaled parameters."""
        return len(self.theta_scaled)

    @property
    def bins(self) -> int:
        """Number of disturbance bins in a segment."""
        return self.square.shape[1] // 6

    @property
    def flight(self) -> Annotated[np.ndarray, "segments"]:
        """Index of the flight of each segment."""
        return self.piece_flight[self.piece]

    def each(self, work: Callable[[np.ndarray, int], Result]) -> list[Result]:
        """Return `work` of the indices of the segments of every flight, and of its index."""
        segments = [np.flatnonzero(self.flight == flight) for flight in range(len(self.nuisances))]
        return parallel.each(lambda flight: work(segments[flight], flight), range(len(segments)), self.jobs)
