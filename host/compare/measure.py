"""Prediction errors of flights with a model and with the nominal model of their vehicle.

The measure is that of held-out flights in a trace (`trimtab.host.trace.prediction`): whole flights from their
references if all logs hold a reference and the control law, else 0.6 s ahead from the recorded inputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trimtab.host.base.errors import UsageError
from trimtab.host.effects import Effect
from trimtab.host.effects.unknowns import TORQUE
from trimtab.host.models.model import NUISANCES, Model
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.logs import TraceData, observable_effects
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.parameters import ParameterSpace, RollOutDiverged, space
from trimtab.host.trace.prediction import Errors, predict_flights, predict_segments
from trimtab.host.trace.segment_fit.model import SegmentModel

MaybeErrors = Sequence[Errors | None]
"""Errors of flights; None for one on which a roll-out is known to diverge."""


def measured_errors(
    logs: TraceData, model: Model | None, effects: Mapping[str, Effect], jobs: int
) -> tuple[MaybeErrors, MaybeErrors, tuple[str, ...]]:
    """Return the errors with the model and with the nominal one, and the effects that do not act.

    model: None for the nominal model. jobs: threads. Raises UsageError if the model has a network and a log
    lacks the reference or the law on board, TooLittleData if a flight is too short.
    """
    if logs.drive == "inputs":
        return _from_inputs(logs, model, effects, jobs)
    nominal = predict_flights(logs.flights, None, effects, jobs=jobs)
    with_model = nominal if model is None else predict_flights(logs.flights, model, effects, jobs=jobs)
    return with_model, nominal, ()


def _from_inputs(
    logs: TraceData, model: Model | None, effects: Mapping[str, Effect], jobs: int
) -> tuple[MaybeErrors, MaybeErrors, tuple[str, ...]]:
    """Return the errors with the model and with the nominal one, and the effects that do not act.

    What the logs leave free, such as an unknown thrust curve, both models take from the model.
    """
    if model is not None and model.network is not None:
        other = next(each.flight for each in logs.flights if not each.flight.flown_by_own_law)
        raise UsageError(
            f"{other.path}: has no reference flown by the law on board, and a network predicts only from "
            "that; leave this log out or give a model without a network"
        )
    in_newton = all(
        each.flight.recorded_inputs is not None and each.flight.recorded_inputs.thrust_n is not None
        for each in logs.flights
    )
    observable = observable_effects(effects, [each.flight for each in logs.flights])
    parameters = space(logs.vehicle, observable, logs.unknown, thrust_commanded=in_newton)
    data, _ = segments_of(logs.flights, rate_driven=TORQUE in logs.unknown)
    segment_model = SegmentModel.of(logs.vehicle, parameters, data, jobs=jobs)
    theta = _theta_scaled(parameters, model)
    freed = np.array([column.owner in parameters.freed for column in parameters.columns])
    nominal = _segment_errors(logs.flights, segment_model, np.where(freed, theta, 0.0))
    with_model = nominal if model is None else _segment_errors(logs.flights, segment_model, theta)
    named = () if model is None else (*model.effects, *model.adjustments)
    return with_model, nominal, tuple(sorted(set(named) - set(parameters.owners) - NUISANCES))


def _segment_errors(
    flights: Sequence[FlightData], segment_model: SegmentModel, theta_scaled: np.ndarray
) -> MaybeErrors:
    """Return the errors of the flights, predicted together; None for one on which a roll-out diverges."""

    def together(chosen: Sequence[FlightData]) -> tuple[Errors, ...] | None:
        try:
            return predict_segments(chosen, segment_model, theta_scaled)
        except RollOutDiverged:
            return None

    errors = together(flights)
    if errors is not None:
        return errors
    finite = [each for each in flights if together([each]) is not None]
    predicted = iter((together(finite) if finite else None) or ())
    return tuple(next(predicted) if each in finite else None for each in flights)


def _theta_scaled(parameters: ParameterSpace, model: Model | None) -> np.ndarray:
    """Return the scaled parameters (P,) at the model's values; 0, which is neutral, where it has none."""
    tables = {} if model is None else {**model.adjustments, **model.effects}
    return np.array(
        [
            (tables.get(column.owner, {}).get(column.key, column.neutral) - column.neutral) / column.scale
            for column in parameters.columns
        ]
    )
