"""Plan a course in every kind and fly the plans by controllers of the comparison."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.apps.paper.controllers.models import Site
from trimtab.host.apps.paper.controllers.table import (
    BASELINE,
    BASELINE_TRAJECTORIES,
    TRAJECTORIES,
    Controller,
    Regressor,
    Set,
)
from trimtab.host.base.errors import Refused, SolverError, UsageError
from trimtab.host.control.files import load_controller
from trimtab.host.control.interface import Controller as HostController
from trimtab.host.control.interface import ControlStep, RateCommand, StateEstimate
from trimtab.host.control.settings import MpcSettings
from trimtab.host.link.controllers import flown_by
from trimtab.host.link.host_control import FlownBy
from trimtab.host.link.simulated import TRUTH_SUFFIX
from trimtab.host.models.correction import correction
from trimtab.host.models.model import Model
from trimtab.host.plan import Plan, Settings, plan
from trimtab.host.plan.flown import fly_plan
from trimtab.host.plan.profile import jerk_rms_m_s3
from trimtab.host.plan.table import from_reference
from trimtab.host.route import Route
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward, Reference

Row = dict[str, Any]


class TimedController:
    """A controller on the host that records the processor time of each of its steps, ms."""

    def __init__(self, inner: HostController) -> None:
        """Time the steps of `inner`."""
        self._inner = inner
        self.steps_ms: list[float] = []

    @property
    def period_us(self) -> int:
        """Time between two control steps."""
        return self._inner.period_us

    def begin(self, reference: Reference) -> None:
        """Prepare to follow `reference`; forget all earlier steps and times."""
        self.steps_ms.clear()
        self._inner.begin(reference)

    def step(self, estimate: StateEstimate, sent: Sequence[RateCommand], act_us: int) -> ControlStep:
        """Return the command that takes effect at `act_us`; as of `host.control.interface.Controller`."""
        started = time.thread_time()
        found = self._inner.step(estimate, sent, act_us)
        self.steps_ms.append(1e3 * (time.thread_time() - started))
        return found

    def times(self) -> dict[str, float]:
        """Return median and 99th percentile of the steps since `begin`."""
        return {f"step_ms_p{p}": float(np.percentile(self.steps_ms, p)) for p in (50, 99)}


@dataclass(frozen=True, kw_only=True)
class Pilot:
    """What flies a reference: a controller with its parameters, feed-forward or stream of commands."""

    flown_by: FlownBy
    feedforward: FeedForward | None = None
    timed: TimedController | None = None


def pilot(controller: Controller, regressor: Regressor, site: Site) -> Pilot:
    """Return what flies for a controller with the models of a site.

    Raises UsageError if the model has nothing to feed forward, or more than the vehicle accepts.
    """
    vehicle = site.field.vehicle
    settings = load_controller(controller.file)
    name = controller.model(regressor)
    model = None if name is None else site.models[name]
    if isinstance(settings, MpcSettings):
        by = flown_by(
            controller.file, settings, vehicle, feedforward=False, model=model, effects=site.effects
        )
        assert by.control is not None
        timed = TimedController(by.control.controller)
        return Pilot(flown_by=FlownBy(control=replace(by.control, controller=timed)), timed=timed)
    fed = None if model is None else _feedforward(model, site)
    by = flown_by(controller.file, settings, vehicle, feedforward=fed is not None)
    return Pilot(flown_by=by, feedforward=fed)


def _feedforward(model: Model, site: Site) -> FeedForward:
    """Return the feed-forward of a model. Raises UsageError."""
    made = correction(model, site.field.vehicle, site.effects)
    if made.feedforward is None:
        raise UsageError("the model has nothing to feed forward")
    if made.excess is not None:
        raise UsageError(f"the feed-forward's {made.excess.quantity} is out of the vehicle's range")
    return made.feedforward


@dataclass(frozen=True, kw_only=True)
class Course:
    """A route to plan in every kind, with the planner's settings.

    nodes: number of shooting intervals, None for the default. flight: index of all its flights in their
    world. They share noise, turbulence and battery.
    """

    route: Route
    flight: int
    settings: Settings
    nodes: int | None = None

    def plans(
        self, vehicle: Vehicle, model: Model, trajectories: Sequence[str] = TRAJECTORIES
    ) -> dict[str, Plan | str]:
        """Return the plan of each trajectory, or why there is none."""
        return {kind: self._plan(vehicle, model, kind) for kind in trajectories}

    def _plan(self, vehicle: Vehicle, model: Model, kind: str) -> Plan | str:
        snap = kind == "min-snap"
        try:
            return plan(
                self.route,
                vehicle,
                kind=kind,
                model=None if snap else model,
                nodes=None if snap else self.nodes,
                settings=self.settings,
            )
        except (Refused, SolverError, UsageError) as error:
            return str(error)


def fly_set(site: Site, course: Course, flown: Set, logs: Path, anchors: Sequence[str] = ()) -> list[Row]:
    """Return a row for each controller of a set and each trajectory, then the baseline's on `anchors`.

    Plans use the regressor of the set. Rows of anchors have `anchor` set. Logs of failed flights stay in
    `logs`.
    """
    logs.mkdir(parents=True, exist_ok=True)
    kinds = tuple(dict.fromkeys((*TRAJECTORIES, *anchors)))
    plans = course.plans(site.field.vehicle, site.models[flown.regressor], kinds)
    in_set = {kind: plans[kind] for kind in TRAJECTORIES}
    rows = []
    for controller in flown.controllers:
        rows += list(fly_controller(site, course, controller, flown.regressor, in_set, logs))
    chosen = {kind: plans[kind] for kind in anchors}
    extra = fly_controller(site, course, BASELINE, flown.regressor, chosen, logs)
    return [row | {"anchor": False} for row in rows] + [row | {"anchor": True} for row in extra]


def fly_baseline(site: Site, course: Course, regressor: Regressor, logs: Path) -> list[Row]:
    """Return a row for each trajectory of the baseline, planned with a regressor."""
    logs.mkdir(parents=True, exist_ok=True)
    plans = course.plans(site.field.vehicle, site.models[regressor], BASELINE_TRAJECTORIES)
    return list(fly_controller(site, course, BASELINE, regressor, plans, logs))


def fly_controller(
    site: Site,
    course: Course,
    controller: Controller,
    regressor: Regressor,
    plans: Mapping[str, Plan | str],
    logs: Path,
) -> Iterator[Row]:
    """Yield a row for each plan, flown by a controller. `failed` says why there is no error, or None."""
    row: Row = {"controller": controller.name, "regressor": regressor}
    try:
        flies: Pilot | str = pilot(controller, regressor, site)
    except UsageError as error:
        flies = str(error)
    for kind, made in plans.items():
        if isinstance(made, str):
            found: Row = {"failed": f"plan: {made}"}
        elif isinstance(flies, str):
            found = {"failed": f"controller: {flies}"}
        else:
            stem = f"{course.route.name}-{controller.name}-{regressor}-{kind.replace('*', 's')}"
            found = _fly(site, course, flies, made, logs / f"{stem}.mcap")
            found["jerk_rms_m_s3"] = jerk_rms_m_s3(from_reference(made.reference))
        yield row | {"trajectory": kind} | found


def _fly(site: Site, course: Course, flies: Pilot, made: Plan, log: Path) -> Row:
    """Return the errors of a flight and the times of its control steps. Keeps the log if it failed."""
    flight = fly_plan(
        made,
        site.field,
        flight=course.flight,
        log=log,
        feedforward=flies.feedforward,
        flown_by=flies.flown_by,
    )
    times = {} if flies.timed is None or not flies.timed.steps_ms else flies.timed.times()
    if flight.failure is not None:
        return {"failed": f"flight: {flight.failure}", **times}
    remove_log(log)
    return {
        "failed": None,
        "error_mean_m": flight.error_mean_m,
        "error_rmse_m": flight.error_rmse_m,
        "error_max_m": flight.error_max_m,
        "clipped_share": flight.clipped_share,
        **times,
    }


def remove_log(log: Path) -> None:
    """Remove a log and the truth beside it: a study of this size would fill the disk."""
    log.unlink()
    log.with_name(log.name + TRUTH_SUFFIX).unlink(missing_ok=True)
