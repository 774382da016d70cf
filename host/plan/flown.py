"""A plan flown by a simulated vehicle, with its tracking error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.base.errors import FlightFailed
from trimtab.host.link.host_control import FlownBy
from trimtab.host.log import read_flight
from trimtab.host.log.tracking import tracking_error
from trimtab.host.plan.result import Plan
from trimtab.protocol.blobs import FeedForward

BY_THE_LAW_ON_BOARD = FlownBy()


@dataclass(frozen=True, kw_only=True)
class Flown:
    """One flight of a plan.

    error_mean_m, error_rmse_m, error_max_m: distance between camera poses and reference over the tracking
    phase. clipped_share: share of the ticks in flight in which motors saturated. failure: why the reference
    was not flown to its end, None where it was. With a failure, the numbers are None.
    """

    log: Path
    error_mean_m: float | None = None
    error_rmse_m: float | None = None
    error_max_m: float | None = None
    clipped_share: float | None = None
    failure: str | None = None


def fly_plan(
    plan: Plan,
    field: Airfield,
    *,
    flight: int,
    log: Path,
    model_id: str | None = None,
    feedforward: FeedForward | None = None,
    flown_by: FlownBy = BY_THE_LAW_ON_BOARD,
) -> Flown:
    """Upload and fly a plan's reference, and return its errors; log and sealed truth remain.

    flight: index of the flight in its world. A flight that ends early or in failsafe has a `failure`; nothing
    is raised.
    """
    try:
        result = field.fly(
            plan.reference,
            flight,
            log,
            feedforward=feedforward,
            parameters=flown_by.parameters,
            control=flown_by.control,
            model_id=model_id,
        )
    except FlightFailed as error:
        return Flown(log=log, failure=str(error))
    error = tracking_error(read_flight(log))
    assert error is not None  # a reference flown to its end has a tracking phase
    return Flown(
        log=log,
        error_mean_m=error.mean_m,
        error_rmse_m=error.rmse_m,
        error_max_m=error.max_m,
        clipped_share=result.clipped_share,
    )
