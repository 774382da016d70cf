"""Roll-outs of phi over lanes: RK4 with a fixed step, the drive sampled at every half step (paper eq. 7).

A lane is one parameter vector on one flight. All lanes advance together, so many flights and many columns of
finite differences cost little more than one.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.codegen.buffered import Buffered
from trimtab.host.codegen.simd import aligned
from trimtab.host.models.drive import DRIVE_ROWS, FF_GAIN, VOLTAGE_AND_TIME
from trimtab.host.models.kernel import RolloutKernel, rollout_kernel
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.reference import FLAT_ROWS, feedforward_rows, flat_outputs, thrust_gain
from trimtab.host.models.step import step_function
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
        Run in C over SIMD lanes where a compiler works. It is then several times faster, after a third of a
        second for a phi and layout that were never compiled on this machine. The results differ by rounding.

    A lane that diverges ends in infinities or NaN and disturbs no other lane.
    """
    lanes = x0.shape[1]
    drive = drive[:, :, None] if drive.ndim == 2 else drive
    flight = flight[:, None] if flight.ndim == 1 else flight
    theta = theta[:, None] if theta.ndim == 1 else theta
    flight_of = _flight_of_lanes(phi, x0, drive, lane_flight)
    if flight.shape[1] > 1:
        flight = flight[:, flight_of]
    data = _Data(
        x0=x0,
        drive=drive,
        flight_of=flight_of,
        flight=np.broadcast_to(flight, (len(flight), lanes)),
        theta=np.broadcast_to(theta, (len(theta), lanes)),
        push=push,
        step_s=step_s,
        every=every,
        rows=rows,
    )
    kernel = rollout_kernel(phi, None if network is None else network.layout) if compiled else None
    if kernel is not None:
        return _roll_out_groups(kernel, network, data)
    return _roll_out_steps(phi, network, data)


@dataclass(frozen=True, kw_only=True)
class _Data:
    """Arguments of `roll_out`, with a column for each lane but in `drive`, which has one for each flight."""

    x0: np.ndarray
    drive: np.ndarray
    flight_of: np.ndarray
    flight: np.ndarray
    theta: np.ndarray
    push: np.ndarray | None
    step_s: float
    every: int
    rows: int

    def samples(self, lanes: int) -> np.ndarray:
        """Return room (n, rows, lanes) for the samples."""
        steps = len(self.drive) // 2
        return aligned((steps // self.every + 1, self.rows, lanes))


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


def _roll_out_groups(kernel: RolloutKernel, network: Network | None, data: _Data) -> np.ndarray:
    """Return the samples (n, rows, lanes), in C by groups of lanes."""
    lanes, width = data.x0.shape[1], kernel.lanes
    samples = data.samples(-(-lanes // width) * width)
    drive = np.ascontiguousarray(data.drive, dtype=float)
    xi = None if network is None else network.xi
    for start in range(0, lanes, width):
        group = np.minimum(np.arange(start, start + width), lanes - 1)  # the last lane fills the last group
        kernel(
            xi,
            _columns(data.x0, group),
            drive,
            np.ascontiguousarray(data.flight_of[group], dtype=ctypes.c_long),
            _columns(data.flight, group),
            _columns(data.theta, group),
            None if data.push is None else _columns(data.push, group),
            step_s=data.step_s,
            every=data.every,
            stages=None,
            samples=samples[:, :, start : start + width],
        )
    return samples[:, :, :lanes]


def _columns(array: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Return these columns, aligned for vectors."""
    out = aligned((*array.shape[:-1], len(index)))
    out[:] = array[..., index]
    return out


def _roll_out_steps(phi: Phi, network: Network | None, data: _Data) -> np.ndarray:
    """Return the samples (n, rows, lanes), by CasADi step by step."""
    lanes = data.x0.shape[1]
    step = Buffered(step_function(phi, None if network is None else network.layout, lanes))
    inputs, x = step.inputs, step.inputs["x"]
    x[:], inputs["flight"][:], inputs["theta"][:] = data.x0, data.flight, data.theta
    inputs["step_s"][:] = data.step_s
    if network is not None:
        inputs["xi"][:] = network.xi
    one_to_one = data.drive.shape[2] == 1 or np.array_equal(data.flight_of, np.arange(data.drive.shape[2]))

    samples = data.samples(lanes)
    samples[0] = x[: data.rows]
    for k in range(len(data.drive) // 2):
        for half in range(3):
            drive = data.drive[2 * k + half]
            inputs[f"drive{half}"][:] = drive if one_to_one else np.take(drive, data.flight_of, axis=1)
            if data.push is not None:
                inputs[f"push{half}"][:] = data.push[2 * k + half]
        step()
        x[:] = step.outputs["next"]
        if (k + 1) % data.every == 0:
            samples[(k + 1) // data.every] = x[: data.rows]
    return samples
