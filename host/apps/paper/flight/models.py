"""The two ways of learning in table II, and the prediction errors of a model over three horizons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trimtab.host.effects import Effect
from trimtab.host.learn import DEFAULT_FORMS, CondensedSettings, Settings, learn
from trimtab.host.learn.ahead import ahead
from trimtab.host.learn.evaluate import Errors, model_parts, whole_flights
from trimtab.host.learn.learn import region
from trimtab.host.learn.train import train
from trimtab.host.log import Flight
from trimtab.host.models.model import Model
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import roll_out
from trimtab.host.models.segments import cut
from trimtab.host.models.states import States, flight_states
from trimtab.host.vehicle import Vehicle

PAPER, OURS = "paper", "ours"
FLIGHTS, SEGMENTS, AHEAD = "flights", "segments", "ahead"
"""Horizons: whole flights and segments of 25 nodes, driven by the reference; AHEAD_S from motor commands."""
AHEAD_SAME_TORQUE = "ahead-same-torque"
"""AHEAD by models that all have the constant torque of ours.

The rate loop balances that torque. Predictions from motor commands have no loop: without the torque they
tilt away, which hides how well a model knows the acceleration.
"""
_TORQUE = "com-offset"
"""Effect of the constant torque, one of DEFAULT_FORMS."""
SEGMENT_STEPS = 24
"""Steps of 20 ms between the 25 nodes of a segment (paper VI-B.2)."""
PAPER_WEIGHT = np.array([1.0, 1.0, 0.0, 0.1, 0.1, 0.0, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0])
"""Diagonal of L (paper VI-B.2), for position, velocity, Euler angles and body rate."""
PAPER_SETTINGS = Settings(
    hidden=(32, 32, 32),
    epochs=40,
    batch=16,
    rate=1e-3,
    l2=0.0,
    patience=40,
    any_heading=False,
    free_start=False,
)
"""As in the paper (VI-B.2): starts as measured, headings as flown, no penalty and no early stop."""


def learn_as_paper(flights: Sequence[Flight], seed: int, *, epochs: int = PAPER_SETTINGS.epochs) -> Model:
    """Return the network of Algorithms 1 and 2 with the settings of section VI-B.2.

    The paper names no validation set: the network of the epoch with the least loss of the training segments
    is taken.
    """
    states = flight_states(flights)
    phi = Phi(vehicle=flights[0].vehicle, estimator=False, parameters=states[0].parameters)
    segments = cut(states, phi, steps=SEGMENT_STEPS)
    settings = replace(PAPER_SETTINGS, epochs=epochs, patience=epochs)
    trained = train(
        phi,
        phi.theta_neutral,
        segments,
        segments,
        settings,
        np.random.default_rng(seed),
        weight=PAPER_WEIGHT,
    )
    return Model(
        vehicle_id=phi.vehicle.id,
        vehicle_name=phi.vehicle.name,
        network=trained.network,
        region=region(states),
        data=tuple(sorted(state.flight_id for state in states)),
    )


def learn_as_ours(flights: Sequence[Flight], effects: Mapping[str, Effect], seed: int) -> tuple[Model, str]:
    """Return the model of the condensed loss with free starts, and the learned part that was selected.

    The settings are the defaults of `trimtab learn`. No flights are held out: those of the test are the
    study's.
    """
    found = learn(
        flights,
        effects=effects,
        settings=CondensedSettings(),
        forms=DEFAULT_FORMS,
        hold_out=(),
        seed=seed,
    )
    return found.model, found.selected.what


def with_torque(models: Mapping[str, Model | None], vehicle: Vehicle) -> dict[str, Model | None]:
    """Return the models with the constant torque of ours; as they are if ours has none."""
    ours = models[OURS]
    if ours is None or _TORQUE not in ours.effects:
        return dict(models)
    alone = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name)
    torque = {_TORQUE: ours.effects[_TORQUE]}
    return {
        name: ours if name == OURS else replace(model or alone, effects=torque)
        for name, model in models.items()
    }


def predict(
    flights: Sequence[Flight],
    model: Model | None,
    effects: Mapping[str, Effect],
    *,
    horizons: Sequence[str],
    states: Sequence[States] | None = None,
) -> dict[str, Errors]:
    """Return a model's errors on flights of one vehicle and one setting; None: the vehicle file alone.

    horizons: one or more of FLIGHTS, SEGMENTS and AHEAD; flights by a controller on the host have AHEAD only.
    states: those of the flights, for callers that predict the same flights by several models.
    """
    states = flight_states(flights) if states is None else states
    parts = model_parts(model, effects)
    phi = Phi(
        vehicle=flights[0].vehicle,
        effects=tuple(effect for effect, _ in parts),
        parameters=states[0].parameters,
    )
    theta, network = phi.theta(parts), None if model is None else model.network
    errors_by = {
        FLIGHTS: lambda: whole_flights(phi, theta, states, network),
        SEGMENTS: lambda: _segments(phi, theta, states, network),
        AHEAD: lambda: ahead(phi, theta, states, flights, network),
    }
    return {horizon: errors_by[horizon]() for horizon in horizons}


def _segments(phi: Phi, theta: np.ndarray, states: Sequence[States], network: Network | None) -> Errors:
    """Return the errors of segments predicted from their measured starts, over all nodes but the first."""
    segments = cut(states, phi, steps=SEGMENT_STEPS)
    predicted = roll_out(
        phi,
        x0=segments.x0.T,
        drive=segments.drive.transpose(1, 2, 0),
        flight=segments.constants.T,
        theta=theta,
        step_s=segments.step_s / segments.split,
        every=segments.split,
        network=network,
        compiled=True,
    )
    error = predicted.transpose(2, 0, 1)[:, 1:, :6] - segments.measured[:, 1:, :6]
    return Errors(
        position_rmse_m=_rms_norm(error[..., :3]),
        velocity_rmse_m_s=_rms_norm(error[..., 3:]),
    )


def _rms_norm(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).sum(-1).mean()))
