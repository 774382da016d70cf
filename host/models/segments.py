"""Segments of flights for learning: equal lengths, with states, drive and start (paper IV-B.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import half_steps, reference_drive
from trimtab.host.models.states import States


@dataclass(frozen=True, kw_only=True, eq=False)
class Segments:
    """Segments of equal length, in steps of `step_s`, which lead from node to node.

    x0: phi's measured state at the start. measured: state at the nodes, with its standard deviation `sigma`.
    drive: at the start, middle and end of each of the `split` parts of a step. flight: index of each
    segment's flight. vectors: index at which each NED vector starts in x0.
    """

    step_s: float
    x0: Annotated[np.ndarray, "segments size"]
    measured: Annotated[np.ndarray, "segments nodes 12"]
    sigma: Annotated[np.ndarray, "segments 12"]
    drive: Annotated[np.ndarray, "segments stages rows"]
    constants: Annotated[np.ndarray, "segments 15"]
    flight: Annotated[np.ndarray, "segments"]
    vectors: tuple[int, ...] = (0, 3)

    @property
    def count(self) -> int:
        """Number of segments."""
        return len(self.x0)

    @property
    def steps(self) -> int:
        """Number of steps of a segment."""
        return self.measured.shape[1] - 1

    @property
    def split(self) -> int:
        """Number of equal parts in which a step is integrated."""
        return self.drive.shape[1] // (2 * self.steps)

    def take(self, indices: Annotated[np.ndarray, "chosen"] | Sequence[int]) -> Segments:
        """Return the segments of these indices, in their order."""
        k = np.asarray(indices, dtype=int)
        return Segments(
            step_s=self.step_s,
            x0=self.x0[k],
            measured=self.measured[k],
            sigma=self.sigma[k],
            drive=self.drive[k],
            constants=self.constants[k],
            flight=self.flight[k],
            vectors=self.vectors,
        )

    def turned(self, angles: Annotated[np.ndarray, "segments"]) -> Segments:
        """Return the segments turned about the vertical by angles in rad.

        They are as valid as those flown, unless something is fixed to the world, such as wind.
        """
        c, s = np.cos(angles), np.sin(angles)
        x0, measured, drive = self.x0.copy(), self.measured.copy(), self.drive.copy()
        for array, vectors, yaw in (
            (x0, self.vectors, 8),
            (measured, (0, 3), 8),
            (drive, (0, 3, 6, 9, 14, 17), 12),
        ):
            shape = (-1,) + (1,) * (array.ndim - 2)
            for k in vectors:
                north, east = array[..., k].copy(), array[..., k + 1].copy()
                array[..., k] = c.reshape(shape) * north - s.reshape(shape) * east
                array[..., k + 1] = s.reshape(shape) * north + c.reshape(shape) * east
            array[..., yaw] += angles.reshape(shape)
        return replace(self, x0=x0, measured=measured, drive=drive)


def cut(flights: Sequence[States], phi: Phi, *, steps: int) -> Segments:
    """Return segments of `steps` steps, end to end over each tracking phase; phi has the drive `reference`.

    All flights have the same step, in as many parts as phi needs. Segments with missing poses, and the
    remainder of a flight, are left out. Raises ValueError where no segment remains.
    """
    if len({states.step_s for states in flights}) > 1:
        raise ValueError("flights on grids of different steps")
    split = phi.substeps(flights[0].step_s)
    rows: list[tuple[np.ndarray, ...]] = []
    for index, states in enumerate(flights):
        total = len(states.t_s) - 1
        times = half_steps(states.t_s[0], split * total, states.step_s / split)
        voltage = np.interp(times, states.t_s, states.voltage_ratio)
        drive = reference_drive(
            states.reference, times, feedforward=states.feedforward, voltage_ratio=voltage
        )
        for k in range(0, total - steps + 1, steps):
            measured = states.x[k : k + steps + 1]
            if states.seen is not None and not states.seen[k : k + steps + 1].all():
                continue
            stages = drive[2 * split * k : 2 * split * (k + steps) + 1]
            start = states.initial(phi, k)
            rows.append((start, measured, states.sigma, stages, states.constants, np.array(index)))
    if not rows:
        raise ValueError(f"no segment of {steps} steps in {len(flights)} flights")
    x0, measured, sigma, stages, constants, flight = (np.array(column) for column in zip(*rows, strict=True))
    return Segments(
        step_s=flights[0].step_s,
        x0=x0,
        measured=measured,
        sigma=sigma,
        drive=stages,
        constants=constants,
        flight=flight,
        vectors=phi.vectors,
    )
