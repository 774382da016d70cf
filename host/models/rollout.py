"""Roll-outs of phi over lanes: RK4 with a fixed step, the drive sampled at every half step (paper eq. 7).

A lane is one parameter vector on one flight. All lanes advance together, so many flights and many columns of
finite differences cost little more than one.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from trimtab.host.models.drive import DRIVE_ROWS, FF_GAIN, VOLTAGE_AND_TIME
from trimtab.host.models.lanes import Lanes
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.reference import FLAT_ROWS, feedforward_rows, flat_outputs, thrust_gain
from trimtab.protocol.blobs import FeedForward, Reference


def half_steps(start_s: float, steps: int, step_s: float) -> Annotated[np.ndarray, "stages"]:
    """Return the 2 steps + 1 times of the stages of RK4: start, middle and end of every step."""
    return start_s + 0.5 * step_s * np.arange(2 * steps + 1)


def reference_drive(
    reference: Reference,
    t_s: Annotated[np.ndarray, "times"],
    *,
    feedforward: FeedForward | None = None,
    voltage_ratio: Annotated[np.ndarray, "times"] | float = 1.0,
) -> Annotated[np.ndarray, "times 23"]:
    """Return the drive `reference` at times since the reference's start."""
    rows = np.empty((DRIVE_ROWS["reference"], len(t_s)))
    rows[:FLAT_ROWS] = flat_outputs(reference, t_s)
    rows[FLAT_ROWS:FF_GAIN] = feedforward_rows(rows[:FLAT_ROWS], feedforward)
    rows[FF_GAIN] = thrust_gain(feedforward, voltage_ratio)
    voltage, time = rows[VOLTAGE_AND_TIME]
    voltage[:] = voltage_ratio
    time[:] = t_s
    return np.ascontiguousarray(rows.T)


def roll_out(  # noqa: PLR0913 (the data of one problem)
    phi: Phi,
    *,
    x0: Annotated[np.ndarray, "size lanes"],
    drive: np.ndarray,
    flight: np.ndarray,
    theta: np.ndarray,
    step_s: float,
    every: int = 1,
    lane_flight: Annotated[np.ndarray, "lanes"] | None = None,
    network: Network | None = None,
    push: Annotated[np.ndarray, "stages 3 lanes"] | None = None,
    rows: int = 12,
    compiled: bool = False,
) -> Annotated[np.ndarray, "samples rows lanes"]:
    """Return the first `rows` states at the start and after every `every` steps.

    Parameters
    ----------
    x0
        Phi's states at the start.
    drive
        (stages, rows of the drive, flights) at `half_steps`; without the last axis for one flight.
    flight
        (15, flights) or (15,), `flight_constants`.
    theta
        (parameters, lanes) or (parameters,).
    step_s
        Integration step; `phi.substeps` gives how fine it must be.
    lane_flight
        Index of each lane's flight; default: as many flights as lanes, or one.
    network
        Residual d(x) that is added to the acceleration.
    push
        Acceleration, NED, that is added at `half_steps`.
    compiled
        Run phi in C where a compiler works. It is then several times faster, after a quarter of a second for
        a phi that was never compiled on this machine.

    A lane that diverges ends in infinities or NaN and disturbs no other lane.
    """
    lanes = x0.shape[1]
    drive = drive[:, :, None] if drive.ndim == 2 else drive
    flight = flight[:, None] if flight.ndim == 1 else flight
    theta = theta[:, None] if theta.ndim == 1 else theta
    flight_of = _flight_of_lanes(phi, x0, drive, lane_flight)
    if flight.shape[1] > 1:
        flight = flight[:, flight_of]
    if compiled and network is None and push is None and phi.integrator is not None:
        constants = [np.broadcast_to(values, (len(values), lanes)).T for values in (flight, theta)]
        samples = phi.integrator(
            x0.T, drive.transpose(2, 0, 1), flight_of, constants, step_s=step_s, every=every, rows=rows
        )
        return samples.transpose(1, 2, 0)
    bound = phi.program.bind(lanes, compiled=compiled)
    bound.inputs["flight"][:] = flight
    bound.inputs["theta"][:] = theta
    return _integrate(_Stages(bound, drive, flight_of, network, push), x0, step_s, every, rows)


def _flight_of_lanes(
    phi: Phi, x0: np.ndarray, drive: np.ndarray, lane_flight: np.ndarray | None
) -> np.ndarray:
    """Return the flight (lanes,) of each lane. Raises ValueError for arrays that do not fit together."""
    size, lanes = x0.shape
    points, _, flights = drive.shape
    if points % 2 == 0 or points < 3:
        raise ValueError(f"drive must have an odd number of rows, at least 3, got {points}")
    if size != phi.size:
        raise ValueError(f"x0 must have {phi.size} rows, got {size}")
    if lane_flight is not None:
        return np.asarray(lane_flight)
    if flights not in (1, lanes):
        raise ValueError(f"{flights} flights for {lanes} lanes: give lane_flight, the flight of each lane")
    return np.arange(lanes) if flights == lanes else np.zeros(lanes, dtype=int)


class _Stages:
    """The derivative of phi at the stages of RK4: write `x`, call `evaluate`, read `xdot`."""

    def __init__(
        self,
        bound: Lanes,
        drive: np.ndarray,
        flight_of: np.ndarray,
        network: Network | None,
        push: np.ndarray | None,
    ) -> None:
        self._bound, self._drive, self._network, self._push = bound, drive, network, push
        self._flight_of = flight_of
        self._one_to_one = drive.shape[2] == 1 or np.array_equal(flight_of, np.arange(bound.lanes))
        self.x, self.xdot = bound.inputs["x"], bound.outputs["xdot"]
        self.steps = (drive.shape[0] - 1) // 2
        self._pushed: np.ndarray | float = 0.0

    def load(self, k: int) -> None:
        """Set the drive and the push to those of half step k."""
        self._pushed = 0.0 if self._push is None else self._push[k]
        drive = self._drive[k]
        self._bound.inputs["drive"][:] = (
            drive if self._one_to_one else np.take(drive, self._flight_of, axis=1)
        )

    def evaluate(self) -> None:
        """Compute xdot at x."""
        residual = self._bound.inputs["acceleration"]
        residual[:] = self._pushed
        if self._network is not None:
            residual[:] += self._network.layout.arrays(self._network.xi, self.x[3:9])
        self._bound()


def _integrate(stages: _Stages, x0: np.ndarray, step_s: float, every: int, rows: int) -> np.ndarray:
    """Return the samples (n, rows, lanes) of RK4 from x0."""
    x = np.array(x0, dtype=float)
    total, scaled = np.empty_like(x), np.empty_like(x)
    samples = np.empty((stages.steps // every + 1, rows, x.shape[1]))
    samples[0] = x[:rows]
    x_in, xdot = stages.x, stages.xdot
    half, sixth = 0.5 * step_s, step_s / 6.0
    with np.errstate(all="ignore"):
        stages.load(0)
        for k in range(stages.steps):
            x_in[:] = x
            stages.evaluate()
            total[:] = xdot
            np.multiply(xdot, half, out=scaled)
            np.add(x, scaled, out=x_in)
            stages.load(2 * k + 1)
            stages.evaluate()
            np.multiply(xdot, 2.0, out=scaled)
            total += scaled
            np.multiply(xdot, half, out=scaled)
            np.add(x, scaled, out=x_in)
            stages.evaluate()
            np.multiply(xdot, 2.0, out=scaled)
            total += scaled
            np.multiply(xdot, step_s, out=scaled)
            np.add(x, scaled, out=x_in)
            stages.load(2 * k + 2)
            stages.evaluate()
            total += xdot
            total *= sixth
            x += total
            if (k + 1) % every == 0:
                samples[(k + 1) // every] = x[:rows]
    return samples
