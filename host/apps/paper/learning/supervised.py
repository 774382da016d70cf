"""What the trajectory loss is measured against: a regression on labels of acceleration, the same otherwise.

The label of a node is the acceleration that smoothing or differences give it, less the nominal model's at the
measured state. Regressors, regularisation, optimiser and early stop are those of the condensed loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trimtab.host.apps.paper.learning.flights import STEP_S, Flights, accelerations, cut
from trimtab.host.apps.paper.learning.measure import Candidate
from trimtab.host.learn.condensed import Condensed, CondensedSettings
from trimtab.host.learn.fit import Basis, Examples, fit
from trimtab.host.learn.linear import effect_scales
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi

_LABEL_SIGMA = 0.01
"""m/s^2: small enough that what is known of an effect's size beforehand does not count."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Labelled:
    """Nodes (S, n) with phi's state (S, n, size), drive (S, n, 23) and acceleration (S, n, 3), NED."""

    states: np.ndarray
    drive: np.ndarray
    acceleration: np.ndarray


def label(flights: Flights, measured: np.ndarray, acceleration: np.ndarray) -> Labelled:
    """Nodes of flights with measured states (F, n, 12) and accelerations (F, n, 3).

    Rotor thrusts and the law's memory are the flights' own: a log holds the commands.
    """
    states = np.concatenate([measured, flights.x[..., 12:]], axis=-1)
    return Labelled(
        states=cut(states), drive=cut(flights.drives(STEP_S)[:, ::2]), acceleration=cut(acceleration)
    )


def train_supervised(
    phi: Phi,
    train: Labelled,
    validation: Labelled,
    settings: CondensedSettings,
    rng: np.random.Generator,
) -> Candidate:
    """Return a network and phi's effects fitted to the labels."""
    basis = Basis(layout=settings.layout, parameters=len(phi.theta_names), delay=False)
    start = np.zeros(basis.size)
    if settings.layout is not None:
        start[: basis.weights] = settings.layout.initial(rng)
    found = fit(
        basis,
        _examples(phi, train),
        _examples(phi, validation),
        start,
        settings,
    )
    network = None if settings.layout is None else Network(layout=settings.layout, xi=found.xi)
    return Candidate(phi=phi, theta=phi.theta_neutral + effect_scales(phi) * found.eta, network=network)


def _examples(phi: Phi, labelled: Labelled) -> Examples:
    """Return the regression as a condensed loss: u is compared with the label node by node."""
    states, acceleration, drive = labelled.states, labelled.acceleration, labelled.drive
    count, nodes = states.shape[:2]
    nominal = accelerations(phi, phi.theta_neutral, None, states, drive)
    columns = [np.tile(np.eye(3 * nodes), (count, 1, 1))]
    for i, scale in enumerate(effect_scales(phi)):
        theta = phi.theta_neutral.copy()
        theta[i] += scale
        moved = accelerations(phi, theta, None, states, drive) - nominal
        columns.append(moved.reshape(count, -1, 1))
    columns.append(np.zeros((count, 3 * nodes, 1)))
    scale = 1.0 / (_LABEL_SIGMA * np.sqrt(nodes))
    jacobian = scale * np.concatenate(columns, axis=2)
    label = scale * (acceleration - nominal).reshape(count, -1)
    return Examples(
        condensed=Condensed(
            hessian=jacobian.swapaxes(1, 2) @ jacobian,
            slope=-(jacobian.swapaxes(1, 2) @ label[:, :, None])[:, :, 0],
            constant=(label**2).sum(1),
            at=np.zeros((count, jacobian.shape[2])),
            nodes=nodes,
        ),
        states=states[:, :, 3:9],
    )
