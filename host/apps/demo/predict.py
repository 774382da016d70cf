"""Prediction of the tracking error of a reference that was not flown, by a roll-out of phi with the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from trimtab.host.codegen import NUMPY
from trimtab.host.effects import Effect
from trimtab.host.log import Flight
from trimtab.host.log.tracking import reference_at
from trimtab.host.models.model import Model
from trimtab.host.models.slots import mocap_latency_s
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.prediction import predict_flights
from trimtab.protocol.blobs import FeedForward, Reference


def predicted_rmse_m(
    flight: Flight,
    reference: Reference,
    model: Model,
    effects: Mapping[str, Effect],
    feedforward: FeedForward | None = None,
) -> float:
    """Return the tracking error RMSE with the model, for the start, link and battery of the given flight.

    `reference` must start at the same point and last as long as the flight's. Returns infinity if the
    roll-out diverges.
    """
    (found,) = predict_flights(
        [FlightData.of(replace(flight, reference=reference, feedforward=feedforward))], model, effects
    )
    # A prediction is of what a late camera shows; where the vehicle is at that time is on the reference then.
    latency_s = float(mocap_latency_s(NUMPY, model.parts(effects)))
    t_us = np.rint(1e6 * (found.t_s - latency_s)).astype(np.int64)
    error = found.p_predicted_ned - reference_at(reference, t_us)[:, :3]
    rmse_m = float(np.sqrt((error**2).sum(axis=1).mean()))
    return rmse_m if np.isfinite(rmse_m) else np.inf
