"""Section VI-D: the pretzel, planned as minimum snap and minimum residual and flown by three controllers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.apps.demo.flights import Airfield
from trimtab.host.apps.paper.flight.controllers import Controller
from trimtab.host.base.errors import FlightFailed, Refused, SolverError, UsageError
from trimtab.host.log import Flight, read_flight
from trimtab.host.log.tracking import reference_at, tracking_errors_ned
from trimtab.host.plan import Plan, ResidualModel, Settings, Weights, plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import Vehicle

ROUTE = "pretzel"
MIN_SNAP, MIN_RESIDUAL = "min-snap", "min-residual"
KINDS = (MIN_SNAP, MIN_RESIDUAL)
NODES = 280
"""Steps of 0.03 s, as in the paper (VI-D.1)."""
LAMBDA_R = 0.1
"""Weight of control effort, per N^2 of rotor thrust (VI-D.1)."""
_RATE_SHARE = Weights().thrust_rate / Weights().control
"""Weight of thrust rates beside control effort, as in the planner's defaults. The paper's cost has none."""
KEPT_EVERY_US = 100_000
"""Every flight keeps the position errors of the poses nearest after each tenth of a second."""
_FLAT_STEP_US = 10_000


def plans(vehicle: Vehicle, model: ResidualModel) -> dict[str, Plan]:
    """Return the pretzel's plan of each kind: same waypoints, time and limits.

    Raises Refused or SolverError if there is none, UsageError if the model has no residual to minimise.
    """
    route = load_route(ROUTE, vehicle=vehicle)
    control = LAMBDA_R * (vehicle.mass_kg * GRAVITY / 4.0) ** 2
    weights = Weights(control=control, thrust_rate=_RATE_SHARE * control)
    paper = Settings(weights=weights, relative_weights=False)
    return {
        MIN_SNAP: plan(route, vehicle, kind=MIN_SNAP),
        MIN_RESIDUAL: plan(route, vehicle, kind=MIN_RESIDUAL, model=model, nodes=NODES, settings=paper),
    }


def fly_pretzel(
    field: Airfield,
    model: ResidualModel,
    controllers: Sequence[Controller],
    folder: Path,
    *,
    flights: Sequence[int],
) -> dict[str, Any]:
    """Plan the pretzel with a model and fly every plan by every controller.

    All combinations fly with the same flight indices, so with the same noise, turbulence and battery. Logs
    stay in `folder`. Returns `plans` by kind, `flights`, a row for each, and `failed`: why there is no plan,
    or None.
    """
    try:
        planned = plans(field.vehicle, model)
    except (Refused, SolverError, UsageError) as error:
        return {"plans": {}, "flights": [], "failed": str(error)}
    rows, legs_length_m = [], load_route(ROUTE, vehicle=field.vehicle).length_m
    for kind, each in planned.items():
        for controller in controllers:
            for index in flights:
                log = folder / f"{ROUTE}-{kind}-{controller.name}-{index}.mcap"
                row = {"kind": kind, "controller": controller.name, "flight": index}
                rows.append(row | _fly(field, each, controller, index, log))
    return {
        "plans": {kind: _figures(each, legs_length_m) for kind, each in planned.items()},
        "flights": rows,
        "failed": None,
    }


def _fly(field: Airfield, planned: Plan, controller: Controller, index: int, log: Path) -> dict[str, Any]:
    """Fly a plan; return its position errors, m, and every tenth second's position and error; or why not.

    The constant part of the errors is their mean vector.
    """
    try:
        result = field.fly(
            planned.reference,
            index,
            log,
            feedforward=controller.feedforward,
            parameters=controller.parameters,
            model_id=controller.model_id,
        )
    except FlightFailed as error:
        return {"failed": str(error)}
    flight = read_flight(log)
    errors = tracking_errors_ned(flight)
    assert errors is not None  # a reference flown to its end has a tracking phase
    distances, constant_ned_m = np.linalg.norm(errors, axis=1), errors.mean(axis=0)
    return {
        "error_mean_m": float(distances.mean()),
        "error_max_m": float(distances.max()),
        "constant_ned_m": constant_ned_m.tolist(),
        "varying_mean_m": float(np.linalg.norm(errors - constant_ned_m, axis=1).mean()),
        "clipped_share": result.clipped_share,
        **_kept(flight, distances),
    }


def _kept(flight: Flight, distances: np.ndarray) -> dict[str, list[Any]]:
    """Return the errors, m, and positions, m NED, of a pose each tenth of a second."""
    assert flight.mocap is not None
    assert flight.tracking is not None
    start_us, end_us = flight.tracking
    inside = (flight.mocap.t_us >= start_us) & (flight.mocap.t_us <= end_us)
    times = flight.mocap.t_us[inside] - start_us
    chosen = np.unique(np.searchsorted(times, np.arange(0, times[-1], KEPT_EVERY_US)))
    path = flight.mocap.p[inside][chosen]
    return {"errors_m": distances[chosen].tolist(), "path_ned_m": path.tolist()}


def _figures(planned: Plan, legs_length_m: float) -> dict[str, Any]:
    """Return the figures of a plan: acceleration, jerk, and a point of its path each tenth of a second.

    legs_length_m: length of the straight lines between the waypoints, which no path undercuts.
    """
    reference = planned.reference
    flat = reference_at(reference, np.arange(0, reference.duration_us, _FLAT_STEP_US))
    acceleration, jerk = (np.linalg.norm(flat[:, rows], axis=1) for rows in (slice(6, 9), slice(9, 12)))
    return {
        "duration_s": planned.duration_s,
        "intervals": planned.intervals,
        "lambda_r": planned.lambda_r,
        "residual_rms_m_s2": planned.residual_rms_m_s2,
        "path_length_m": planned.path_length_m,
        "legs_length_m": legs_length_m,
        "solve_s": planned.solve_s,
        "acceleration_max_m_s2": float(acceleration.max()),
        "acceleration_mean_m_s2": float(acceleration.mean()),
        "jerk_max_m_s3": float(jerk.max()),
        "jerk_mean_m_s3": float(jerk.mean()),
        "path_ned_m": flat[:: KEPT_EVERY_US // _FLAT_STEP_US, :3].tolist(),
    }
