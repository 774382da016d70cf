"""One-step supervision: a network fitted to labels of the residual acceleration (Neural-C, paper V-B).

The label of a sample is the acceleration of the smoothed path, less that of the nominal vehicle at the same
state and at the rotor thrusts commanded (the control input). The paper's network also has the control input
among its inputs. Ours has the inputs of every `Layout`, v and Theta: at a known attitude and acceleration the
control input adds the thrust alone, and the label already accounts for the thrust.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from trimtab.host.codegen import NUMPY
from trimtab.host.learn.condensed import Condensed, CondensedSettings
from trimtab.host.learn.fit import Basis, Examples, fit, initial
from trimtab.host.learn.learn import SEGMENT_STEPS, region
from trimtab.host.learn.quick import random_headings
from trimtab.host.log import Flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.log.prepare import prepare
from trimtab.host.models.airframe import THETA, V
from trimtab.host.models.dynamics import rigid_body
from trimtab.host.models.model import Model
from trimtab.host.models.network import Network
from trimtab.host.models.states import States, states_of

_LABEL_SIGMA = 0.01
"""m/s^2: small enough that what is known of an effect's size beforehand does not count."""
_LEAST_SEGMENTS = 8


def learn_supervised(
    flights: Sequence[Flight],
    *,
    settings: CondensedSettings | None = None,
    accelerations: Sequence[np.ndarray] | None = None,
    seed: int = 0,
    provenance: Mapping[str, Any] | None = None,
) -> Model:
    """Return a model whose network predicts the residual acceleration of one vehicle's flights.

    A fifth of the segments of a second, drawn at random, decides when to stop. settings: layout, iterations,
    patience, l2 and any_heading count. accelerations: (samples, 3) of each flight, m/s^2, NED, on the grid of
    `prepare(flights)`, in place of those of the smoothed path. Raises ValueError without a layout or for
    accelerations of a wrong shape, TooLittleData for flights of several vehicles or of less than eight
    seconds.
    """
    settings = settings or CondensedSettings()
    if settings.layout is None:
        raise ValueError("supervised learning needs the layout of a network")
    vehicle = flights[0].vehicle
    if any(flight.vehicle.id != vehicle.id for flight in flights):
        raise TooLittleData("the flights are of several vehicles; give those of one")
    rng = np.random.default_rng(seed)
    prepared = prepare(flights)
    states = [states_of(each) for each in prepared]
    smoothed = [each.a for each in prepared]
    given = smoothed if accelerations is None else accelerations
    if [each.shape for each in given] != [each.shape for each in smoothed]:
        raise ValueError(
            f"accelerations of shapes {[each.shape for each in given]}; "
            f"the flights need {[each.shape for each in smoothed]}"
        )
    nodes, labels = _segments(states, given)
    if len(nodes) < _LEAST_SEGMENTS:
        raise TooLittleData(
            f"{len(nodes)} segments of a second are too few to learn from; give {_LEAST_SEGMENTS} s of flight"
        )
    order, checks = rng.permutation(len(nodes)), len(nodes) // 5
    train, validation = order[checks:], order[:checks]
    basis = Basis(layout=settings.layout, parameters=0, delay=False)
    fitted = fit(
        basis,
        label_examples(nodes[train], labels[train]),
        label_examples(nodes[validation], labels[validation]),
        initial(settings.layout, rng),
        settings,
        headings=random_headings(settings, len(train), rng),
    )
    return Model(
        vehicle_id=vehicle.id,
        vehicle_name=vehicle.name,
        network=Network(layout=settings.layout, xi=fitted.xi),
        region=region(states),
        data=tuple(sorted({flight.id for flight in flights})),
        provenance=provenance or {},
    )


def label_examples(
    states: Annotated[np.ndarray, "segments nodes 6"],
    labels: Annotated[np.ndarray, "segments nodes 3"],
    moved: Annotated[np.ndarray, "segments accelerations parameters"] | None = None,
) -> Examples:
    """Return the regression on labels as a condensed loss, compared node by node.

    states: v_ned and Theta. labels: m/s^2, NED. moved: change of all accelerations of a segment by the
    typical size of each parameter that is learned beside the network.
    """
    count, nodes = states.shape[:2]
    columns = [np.tile(np.eye(3 * nodes), (count, 1, 1)), np.zeros((count, 3 * nodes, 1))]
    if moved is not None:
        columns.insert(1, moved)
    scale = 1.0 / (_LABEL_SIGMA * np.sqrt(nodes))
    jacobian = scale * np.concatenate(columns, axis=2)
    label = scale * labels.reshape(count, -1)
    return Examples(
        condensed=Condensed(
            hessian=jacobian.swapaxes(1, 2) @ jacobian,
            slope=-(jacobian.swapaxes(1, 2) @ label[:, :, None])[:, :, 0],
            constant=(label**2).sum(1),
            at=np.zeros((count, jacobian.shape[2])),
            curvature=np.full(count, scale**2),
            knots=nodes,
        ),
        states=states,
    )


def residual_labels(
    states: States, acceleration: Annotated[np.ndarray, "samples 3"]
) -> Annotated[np.ndarray, "samples 3"]:
    """Return the acceleration (m/s^2, NED) that the nominal vehicle does not have at states and thrusts."""
    rows = [*states.x.T, *states.thrust.T]
    return acceleration - np.array(rigid_body(NUMPY, states.vehicle, (), rows)[V]).T


def _segments(
    flights: Sequence[States], accelerations: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return v_ned and Theta (S, 50, 6) and labels (S, 50, 3) of the segments with poses everywhere."""
    nodes, labels = [np.empty((0, SEGMENT_STEPS, 6))], [np.empty((0, SEGMENT_STEPS, 3))]
    for states, acceleration in zip(flights, accelerations, strict=True):
        label = residual_labels(states, acceleration)
        seen = np.ones(len(label), dtype=bool) if states.seen is None else states.seen
        for first in range(0, len(label) - SEGMENT_STEPS + 1, SEGMENT_STEPS):
            part = slice(first, first + SEGMENT_STEPS)
            if seen[part].all():
                nodes.append(states.x[None, part, V.start : THETA.stop])
                labels.append(label[None, part])
    return np.concatenate(nodes), np.concatenate(labels)
