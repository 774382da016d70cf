"""Roll-outs of phi over numpy lanes: RK4, fixed step, the reference interpolated inside it (paper eq. 7).

A lane is one parameter vector on one flight; all lanes advance together, so many flights and many columns of
finite differences cost little more than one.
"""

from __future__ import annotations

import numpy as np

from trimtab.host.models.drive import DRIVE_ROWS
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.reference import FLAT_ROWS, feedforward_rows, flat_outputs
from trimtab.protocol.blobs import FeedForward, Reference


def half_steps(start_s: float, steps: int, step_s: float) -> np.ndarray:
    """(2 steps + 1,) times of the stages of RK4: every step's start, middle and end."""
    return start_s + 0.5 * step_s * np.arange(2 * steps + 1)


def reference_drive(
    reference: Reference,
    t_s: np.ndarray,
    *,
    feedforward: FeedForward | None = None,
    voltage_ratio: np.ndarray | float = 1.0,
) -> np.ndarray:
    """(n, 22): the drive `reference` at times (n,) since the reference's start."""
    rows = np.empty((DRIVE_ROWS["reference"], len(t_s)))
    rows[:FLAT_ROWS] = flat_outputs(reference, t_s)
    rows[FLAT_ROWS:20] = feedforward_rows(rows[:FLAT_ROWS], feedforward)
    rows[20] = voltage_ratio
    rows[21] = t_s
    return np.ascontiguousarray(rows.T)


def roll_out(
    phi: Phi,
    *,
    x0: np.ndarray,
    drive: np.ndarray,
    flight: np.ndarray,
    theta: np.ndarray,
    step_s: float,
    every: int = 1,
    lane_flight: np.ndarray | None = None,
    network: Network | None = None,
    push: np.ndarray | None = None,
    rows: int = 12,
    compiled: bool = False,
) -> np.ndarray:
    """(n, rows, lanes): the first `rows` states at the start and after every `every` steps.

    Parameters
    ----------
    x0
        (size, lanes).
    drive
        (2 steps + 1, rows of the drive, flights) at `half_steps`, or without the last axis for one.
    flight
        (16, flights) or (16,), `flight_constants`.
    theta
        (parameters, lanes) or (parameters,).
    step_s
        integration step; `phi.substeps` says how fine it must be.
    lane_flight
        (lanes,) index of each lane's flight; default: as many flights as lanes, or one.
    network
        residual d(x) added to the acceleration.
    push
        (2 steps + 1, 3, lanes) acceleration, NED, added at `half_steps`.
    compiled
        run phi in C where a compiler works: it is then several times faster, after a quarter of a
        second for a phi that was never compiled here.

    A lane that diverges ends in infinities or NaN; it disturbs no other lane.
    """
    size, lanes = x0.shape
    drive = drive[:, :, None] if drive.ndim == 2 else drive
    flight = flight[:, None] if flight.ndim == 1 else flight
    theta = theta[:, None] if theta.ndim == 1 else theta
    steps, odd = divmod(drive.shape[0] - 1, 2)
    if odd or steps < 1:
        raise ValueError(f"drive must have an odd number of rows, at least 3, got {drive.shape[0]}")
    if size != phi.size:
        raise ValueError(f"x0 must have {phi.size} rows, got {size}")
    flights = drive.shape[2]
    if lane_flight is None and flights not in (1, lanes):
        raise ValueError(f"{flights} flights for {lanes} lanes: say which lane flies which")
    own = np.arange(lanes) if flights == lanes else np.zeros(lanes, dtype=int)
    flight_of = own if lane_flight is None else np.asarray(lane_flight)
    gather = flights != 1 and not np.array_equal(flight_of, np.arange(lanes))

    if compiled and network is None and push is None and phi.integrator is not None:
        each = flight if flight.shape[1] == 1 else flight[:, flight_of]
        constants = [np.broadcast_to(values, (len(values), lanes)).T for values in (each, theta)]
        samples = phi.integrator(
            x0.T, drive.transpose(2, 0, 1), flight_of, constants, step_s=step_s, every=every, rows=rows
        )
        return samples.transpose(1, 2, 0)

    bound = phi.program.bind(lanes, compiled=compiled)
    x_in, drive_in, xdot = bound.inputs["x"], bound.inputs["drive"], bound.outputs["xdot"]
    bound.inputs["flight"][:] = flight if flight.shape[1] == 1 else flight[:, flight_of]
    bound.inputs["theta"][:] = theta
    residual = bound.inputs["acceleration"]
    x = np.array(x0, dtype=float)
    total, scaled = np.empty_like(x), np.empty_like(x)
    samples = np.empty((steps // every + 1, rows, lanes))
    samples[0] = x[:rows]
    pushed: np.ndarray | float = 0.0

    def load(k: int) -> None:
        nonlocal pushed
        pushed = 0.0 if push is None else push[k]
        if gather:
            drive_in[:] = np.take(drive[k], flight_of, axis=1)
        else:
            drive_in[:] = drive[k]

    def stage() -> None:
        residual[:] = pushed
        if network is not None:
            residual[:] += network.layout.arrays(network.xi, x_in[3:9])
        bound()

    half, sixth = 0.5 * step_s, step_s / 6.0
    with np.errstate(all="ignore"):
        load(0)
        for k in range(steps):
            x_in[:] = x
            stage()
            total[:] = xdot
            np.multiply(xdot, half, out=scaled)
            np.add(x, scaled, out=x_in)
            load(2 * k + 1)
            stage()
            np.multiply(xdot, 2.0, out=scaled)
            total += scaled
            np.multiply(xdot, half, out=scaled)
            np.add(x, scaled, out=x_in)
            stage()
            np.multiply(xdot, 2.0, out=scaled)
            total += scaled
            np.multiply(xdot, step_s, out=scaled)
            np.add(x, scaled, out=x_in)
            load(2 * k + 2)
            stage()
            total += xdot
            total *= sixth
            x += total
            if (k + 1) % every == 0:
                samples[(k + 1) // every] = x[:rows]
    return samples
