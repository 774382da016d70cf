"""The data of section V-A: short flights of a closed loop with drag, exact, at nodes of 20 ms.

The learner's own closed loop flies them: phi with a linear drag, integrated in steps of 1 ms, of which the
learner sees every twentieth. The paper does not say how it simulates its flights. These measure the learning
alone; flights through firmware, radio and a separate plant are in `trimtab.host.apps.paper.learning.flown`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trimtab.host.effects import load_effects
from trimtab.host.models.drive import flight_constants
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.reference import flat_outputs
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.segments import Segments
from trimtab.host.plan.snap import optimise_durations
from trimtab.host.plan.table import snap_table, to_reference
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference, YawNode

DRAG = (0.45, 0.35, 0.25)
"""1/s along the body's axes. Our choice, to give the paper's nominal error of 0.6 to 0.7 m/s^2."""

STEP_S, SEGMENT_NODES = 0.02, 50
"""Between nodes; of a segment (paper V-A)."""

_FINE_S = 1e-3
_BOX_M = np.array([2.6, 2.6, 1.0])
_MIDDLE_NED = np.array([0.0, 0.0, -1.5])
_WAYPOINTS = 5
_DURATION_S, _OOD_FASTER = 4.0, 1.25
_COUNTS = {"train": 32, "test": 8, "validation": 3, "ood": 8}
"""8:2 as in the paper; its three for validation are drawn beside the forty."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Flights:
    """Flights of one closed loop `phi` at values `theta` (P,): x (F, n, size) at nodes STEP_S apart."""

    phi: Phi
    theta: np.ndarray
    references: tuple[Reference, ...]
    x: np.ndarray

    def drives(self, step_s: float, *, late_s: float = 0.0) -> np.ndarray:
        """Return the drive (F, 2 m + 1, 23) at starts, middles and ends of the steps of the whole flight.

        The reference is delayed by `late_s`.
        """
        steps = int((self.x.shape[1] - 1) * STEP_S / step_s + 1e-6)
        times = half_steps(-late_s, steps, step_s)
        return np.stack([reference_drive(reference, times) for reference in self.references])

    def take(self, count: int) -> Flights:
        """Return the first `count` of them."""
        return replace(self, references=self.references[:count], x=self.x[:count])

    def segments(self, phi: Phi, *, measured: np.ndarray, sigma: np.ndarray, held: bool = False) -> Segments:
        """Return segments of 50 nodes for a model `phi` with the same state.

        `measured` (F, n, 12) has standard deviations `sigma` (12,). With `held`, the reference is constant
        within a step, which delays it by half a step on average.
        """
        drive = self.drives(STEP_S, late_s=0.5 * STEP_S if held else 0.0)
        seen, states = cut(measured), cut(self.x)
        count, each = len(seen), len(seen) // len(self.x)
        starts = SEGMENT_NODES * (np.arange(count) % each)
        stages = np.arange(2 * SEGMENT_NODES - 1)
        flight = np.arange(count) // each
        return Segments(
            step_s=STEP_S,
            x0=np.concatenate([seen[:, 0], states[:, 0, 12:]], axis=1),
            measured=seen,
            sigma=np.repeat(sigma[None], count, axis=0),
            drive=drive[flight[:, None], 2 * starts[:, None] + stages],
            constants=np.repeat(flight_constants()[None], count, axis=0),
            flight=flight,
            vectors=phi.vectors,
        )


def cut(nodes: np.ndarray) -> np.ndarray:
    """Return flights (F, n, ..) cut into segments (S, 50, ..) without an incomplete last one."""
    each = nodes.shape[1] // SEGMENT_NODES
    kept = nodes[:, : each * SEGMENT_NODES]
    return kept.reshape(len(nodes) * each, SEGMENT_NODES, *nodes.shape[2:])


def make_flights(
    vehicle: Vehicle,
    seed: int,
    *,
    counts: dict[str, int] | None = None,
) -> dict[str, Flights]:
    """Return flights of `vehicle` with drag by set: train, test, validation, ood (25 % faster)."""
    effect = load_effects()["linear-drag"]
    phi = Phi(vehicle=vehicle, effects=(effect,), estimator=False)
    rng = np.random.default_rng([seed, 0])
    sets = {}
    for name, count in (counts or _COUNTS).items():
        duration_s = _DURATION_S / (_OOD_FASTER if name == "ood" else 1.0)
        references = tuple(_reference(rng, vehicle, duration_s) for _ in range(count))
        sets[name] = fly(phi, phi.theta([(effect, effect.theta(DRAG))]), references)
    return sets


def fly(phi: Phi, theta: np.ndarray, references: tuple[Reference, ...]) -> Flights:
    """Fly references of equal duration by phi at theta, from rest at their first nodes."""
    nodes = round(references[0].nodes[-1].t_us * 1e-6 / STEP_S)
    steps = (nodes - 1) * round(STEP_S / _FINE_S)
    starts = [flat_outputs(reference, np.zeros(1))[:3, 0] for reference in references]
    times = half_steps(0.0, steps, _FINE_S)
    states = roll_out(
        phi,
        x0=np.stack([phi.hover(tuple(start), 0.0) for start in starts], axis=1),
        drive=np.stack([reference_drive(reference, times) for reference in references], axis=2),
        flight=flight_constants(),
        theta=theta,
        step_s=_FINE_S,
        every=round(STEP_S / _FINE_S),
        rows=phi.size,
        compiled=True,
    )
    return Flights(phi=phi, theta=theta, references=references, x=states.transpose(2, 0, 1))


def accelerations(
    phi: Phi, theta: np.ndarray, network: Network | None, x: np.ndarray, drive: np.ndarray
) -> np.ndarray:
    """Return accelerations (F, n, 3), NED, of phi and a network at states (F, n, size), drive (F, n, 23)."""
    flat, rows = x.reshape(-1, phi.size).T, drive.reshape(-1, drive.shape[2]).T
    residual = np.zeros((3, flat.shape[1]))
    if network is not None:
        residual = network.layout.arrays(network.xi, flat[3:9])
    constants = np.repeat(flight_constants()[:, None], flat.shape[1], axis=1)
    values = np.repeat(theta[:, None], flat.shape[1], axis=1)
    xdot = np.array(phi.function(flat, rows, constants, values, residual))
    return xdot[3:6].T.reshape(*x.shape[:2], 3)


def _reference(rng: np.random.Generator, vehicle: Vehicle, duration_s: float) -> Reference:
    """Return a minimum-snap reference with optimised times through five waypoints drawn in a box."""
    waypoints = _MIDDLE_NED + rng.uniform(-0.5, 0.5, (_WAYPOINTS, 3)) * _BOX_M
    table = snap_table(waypoints, optimise_durations(waypoints, duration_s))
    return to_reference(table, [YawNode(0, 0.0, 0.0)], vehicle.id)
