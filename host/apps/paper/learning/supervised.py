"""What the trajectory loss is measured against: a regression on labels of acceleration, the same otherwise.

The label of a node is the acceleration that smoothing or differences give it, less the nominal model's at the
measured state. Regressors, regularisation, optimiser and early stop are those of the condensed loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trimtab.host.apps.paper.learning.flights import STEP_S, Flights, accelerations, cut
from trimtab.host.apps.paper.learning.measure import Candidate
from trimtab.host.learn.condensed import CondensedSettings
from trimtab.host.learn.fit import Basis, Examples, fit, initial
from trimtab.host.learn.linear import effect_scales
from trimtab.host.learn.supervised import label_examples
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi


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
        start[: basis.weights] = initial(settings.layout, rng)
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
    """Return the regression on the labels, with columns for phi's effects."""
    states, acceleration, drive = labelled.states, labelled.acceleration, labelled.drive
    count, nodes = states.shape[:2]
    nominal = accelerations(phi, phi.theta_neutral, None, states, drive)
    moved = np.empty((count, 3 * nodes, len(phi.theta_names)))
    for i, scale in enumerate(effect_scales(phi)):
        theta = phi.theta_neutral.copy()
        theta[i] += scale
        change = accelerations(phi, theta, None, states, drive) - nominal
        moved[:, :, i] = change.reshape(count, -1)
    return label_examples(states[:, :, 3:9], acceleration - nominal, moved)
