"""Run one demo: plan, upload, fly, trace, plan again, fly again, report, open the truth."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.apps.demo import report
from trimtab.host.apps.demo.applied import to_apply
from trimtab.host.apps.demo.compare import Comparison, Tracked, latency_of, pooled_rmse_m, tracked
from trimtab.host.apps.demo.files import (
    FEEDFORWARD_NAME,
    JSON_NAME,
    MODEL_NAME,
    REPORT_NAME,
    TRUTH_PAGE,
    DemoFiles,
)
from trimtab.host.apps.demo.flights import WORLD, Airfield, upload_through_pty
from trimtab.host.apps.demo.plans import Planned, fastest, plan_again, plan_first
from trimtab.host.apps.demo.predict import predicted_rmse_m
from trimtab.host.apps.demo.routes import DemoRoutes, draw_routes
from trimtab.host.apps.demo.seeds import host_seed, world_seed
from trimtab.host.apps.demo.steps import OnMessage, Steps
from trimtab.host.apps.demo.truth_page import write_truth_page
from trimtab.host.base.errors import FlightFailed, Refused, SolverError, TrimtabError
from trimtab.host.base.output import json_text
from trimtab.host.effects import Effect
from trimtab.host.log import Flight, log_parents, read_flight
from trimtab.host.models.file import write_model
from trimtab.host.models.model import Model
from trimtab.host.plan import Plan
from trimtab.host.plan.residual import ResidualModel
from trimtab.host.report.figures import Figure
from trimtab.host.report.trace import page, pictures, shown_flights, titles_of
from trimtab.host.trace.answer import to_json
from trimtab.host.trace.result import Trace
from trimtab.host.trace.run import Manoeuvres, run
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward

REPEATS = 2
FAILURES = (Refused, SolverError, FlightFailed)
"""Errors of a second plan or flight that do not end the demo."""


@dataclass(frozen=True, kw_only=True)
class DemoRequest:
    """Settings of a demo.

    `folder` receives every file and is made if missing; `force` overwrites files. If `routes` is None, they
    are drawn from the seed. `repeats` is the number of repeat flights of each reference to learn from.
    """

    vehicle: Vehicle
    folder: Path
    seed: int
    world: str = WORLD
    routes: DemoRoutes | None = None
    repeats: int = REPEATS
    force: bool = False


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a demo: the trace, the flown comparison, and the JSON object without wall time.

    steps: title and seconds of each. failure: the first error of a second plan or flight, or None; report and
    answer are complete in both cases.
    """

    result: Trace
    comparison: Comparison
    answer: Mapping[str, Any]
    steps: tuple[tuple[str, float], ...]
    failure: TrimtabError | None


def run_demo(
    request: DemoRequest,
    effects: Mapping[str, Effect],
    pool: Executor,
    *,
    on_message: OnMessage = lambda line: None,
    manoeuvres: Manoeuvres | None = None,
) -> Outcome:
    """Run a demo; its files are in the folder of the request. The processes of the pool change no file.

    Raises ConfigurationError if there is no such world, Refused or PlanUnsolved for a first plan,
    FlightFailed for a failsafe before the trace, and the errors of tracing. Logs of finished flights stay
    readable.
    """
    return _Demo(request, effects, pool, on_message, manoeuvres).run()


@dataclass(frozen=True, eq=False)
class _Order:
    """A flight of the second part of the demo."""

    label: str
    planned: Planned
    feedforward: FeedForward | None = None


class _Demo:
    def __init__(
        self,
        request: DemoRequest,
        effects: Mapping[str, Effect],
        pool: Executor,
        on_message: OnMessage,
        manoeuvres: Manoeuvres | None,
    ) -> None:
        self._request = request
        self._effects = effects
        self._pool = pool
        self._on_message = on_message
        self._manoeuvres = manoeuvres
        self._seed = host_seed(request.seed)
        self._files = DemoFiles(
            folder=request.folder, vehicle=request.vehicle, seed=self._seed, force=request.force
        )
        self._steps = Steps(on_message)
        self._routes = request.routes or draw_routes(self._seed, request.vehicle.limits)
        self._field = Airfield(
            vehicle=request.vehicle,
            world=request.world,
            world_seed=world_seed(request.seed),
            session=self._files.session(),
            force=request.force,
        )
        self._flights = 0
        self._later: list[Flight] = []
        self._failures: list[TrimtabError] = []

    def run(self) -> Outcome:
        self._field.check()
        request = self._request
        self._on_message(
            f"demo with seed {request.seed}, vehicle {request.vehicle.name}; "
            f"every file goes to {request.folder}"
        )
        request.folder.mkdir(parents=True, exist_ok=True)
        learning, held_out = self._plan()
        used, unseen = self._fly(learning, held_out)
        result = self._trace([flight for _, flight in used], [flight for _, flight in unseen])
        model_path = self._request.folder / MODEL_NAME
        write_model(result.model, model_path, force=self._request.force)
        comparison, drawn = self._again(learning, used, result)
        answer = self._report(result, comparison, used, unseen, drawn)
        with self._steps.step("truth") as (_, done):
            done(write_truth_page(self._files, used[0][1], self._effects))
        return Outcome(
            result=result,
            comparison=comparison,
            answer=answer,
            steps=tuple(self._steps.times),
            failure=self._failures[0] if self._failures else None,
        )

    # Steps.

    def _plan(self) -> tuple[list[Planned], list[Planned]]:
        routes = (*self._routes.learning, *self._routes.held_out)
        with self._steps.step("plan", len(routes)) as (bar, done):
            plans = []
            for route in routes:
                bar.advance(0.0, route.name)
                planned = plan_first(route, self._request.vehicle)
                self._files.write_plan(planned)
                plans.append(planned)
                bar.advance()
            seconds = sum(planned.plan.duration_s for planned in plans)
            done(f"{len(plans)} references with the nominal model, {seconds:.0f} s to fly")
        count = len(self._routes.learning)
        return plans[:count], plans[count:]

    def _fly(
        self, learning: list[Planned], held_out: list[Planned]
    ) -> tuple[list[tuple[Planned, Flight]], list[tuple[Planned, Flight]]]:
        """Fly every plan. The first reference goes on board through a pty, the others in lock-step.

        The others fly while the first goes on board, which takes its time on the wire.
        """
        field, first = self._field, learning[0]
        reference = first.plan.reference
        queue = [planned for planned in learning for _ in range(self._request.repeats)] + held_out
        begun = [(planned, *self._next_flight(planned)) for planned in queue]
        running = [
            self._pool.submit(field.fly, planned.plan.reference, number, log)
            for planned, number, log in begun[1:]
        ]
        with self._steps.step("upload") as (bar, done):
            simulated = field.power_up(reference, 1)
            bar.advance(0.0, first.name)
            port, sent = upload_through_pty(simulated, reference)
            done(
                f"reference {first.name} through pyserial at {port}: {len(reference.to_bytes())} B in "
                f"{sent.frames_sent} frames, checked on board and live"
            )
        with self._steps.step("fly", len(queue)) as (bar, done):
            bar.advance(0.0, first.name)
            with closing(simulated):
                simulated.power_cycle(1)  # it starts with its memory intact
                field.fly_with(simulated, reference, *begun[0][1:])
            bar.advance(1.0, first.name)
            for (planned, *_), flight in zip(begun[1:], running, strict=True):
                flight.result()
                bar.advance(1.0, planned.name)
            flown = [(planned, read_flight(log)) for planned, _, log in begun]
            count = len(queue) - len(held_out)
            errors = [tracked("", f, p, latency_s=0.0).stamped_rmse_m for p, f in flown]
            done(
                f"{count} flights to learn from (the first with the reference uploaded through the pty, the "
                f"others over the simulated link) and {len(held_out)} held out; tracking error "
                f"{1e3 * float(np.mean(errors)):.0f} mm RMSE on average"
            )
        return flown[:count], flown[count:]

    def _trace(self, used: list[Flight], held_out: list[Flight]) -> Trace:
        with self._steps.step("trace") as (bar, done):
            result = run(
                used,
                held_out,
                self._effects,
                vehicle=self._request.vehicle,
                manoeuvres=self._manoeuvres,
                provenance=self._files.provenance(log_parents(used, held_out)),
                on_progress=lambda step: bar.advance(0.0, step),
            )
            names = ", ".join(effect.name for effect in result.effects)
            text = result.verdict + (f": {names}" if names else "")
            if result.before_score and result.after_score:
                before, after = (s["position_rmse_m"] for s in (result.before_score, result.after_score))
                text += f"; prediction error on held-out flights {1e3 * before:.0f} to {1e3 * after:.0f} mm"
            done(text)
        return result

    def _again(
        self, learning: list[Planned], used: list[tuple[Planned, Flight]], result: Trace
    ) -> tuple[Comparison, Sequence[Figure]]:
        """Fly the fastest route again: with a new plan, and then with the effects applied, if possible.

        Return the flights' comparison and the figures of the trace, which are drawn while they fly.
        """
        route = fastest(learning)
        latency_s = latency_of(result)
        earlier = [flight for planned, flight in used if planned is route]
        first = tuple(
            tracked(f"first flight {i}", flight, route, latency_s=latency_s)
            for i, flight in enumerate(earlier, start=1)
        )
        if not result.effects:
            why = "nothing was traced"
            nothing = Comparison(first=first, latency_s=latency_s, no_new_plan=why, no_applied=why)
            return nothing, pictures(result)
        model = result.model

        def predict(plan: Plan, feedforward: FeedForward | None = None) -> float:
            return predicted_rmse_m(earlier[0], plan.reference, model, self._effects, feedforward)

        second, no_new_plan = self._plan_again(route, model, predict)
        flown, label = (route, "first plan") if second is None else (second, "new plan")
        feedforward, no_applied = to_apply(
            model, self._request.vehicle, self._effects, partial(predict, flown.plan)
        )
        if feedforward is not None:
            self._files.write(FEEDFORWARD_NAME, feedforward.to_bytes())
        new_order = None if second is None else _Order("new plan", second)
        applied_order = (
            None if feedforward is None else _Order(f"{label}, effects applied", flown, feedforward)
        )
        orders = [order for order in (new_order, applied_order) if order is not None]
        landed, drawn = self._fly_again(orders, first, result, predict)
        new_plan, no_new_plan = landed.get(new_order, (None, no_new_plan))
        applied, no_applied = landed.get(applied_order, (None, no_applied))
        comparison = Comparison(
            first=first,
            latency_s=latency_s,
            new_plan=new_plan,
            applied=applied,
            no_new_plan=no_new_plan or None,
            no_applied=no_applied or None,
        )
        return comparison, drawn

    def _fly_again(
        self,
        orders: Sequence[_Order],
        first: Sequence[Tracked],
        result: Trace,
        predict: Callable[[Plan, FeedForward | None], float],
    ) -> tuple[dict[_Order | None, tuple[Tracked | None, str]], Sequence[Figure]]:
        """Fly all at once. Return each flight and an empty reason, or None and the reason of its failure.

        The figures of the trace are drawn meanwhile.
        """
        if not orders:
            return {}, pictures(result)
        landed: dict[_Order | None, tuple[Tracked | None, str]] = {}
        figures: list[str] = []
        with self._steps.step("fly again", len(orders)) as (bar, done):
            begun = [(order, *self._next_flight(order.planned)) for order in orders]
            running = [
                self._pool.submit(
                    self._field.fly,
                    order.planned.plan.reference,
                    number,
                    log,
                    feedforward=order.feedforward,
                    model_id=result.model.id,
                )
                for order, number, log in begun
            ]
            drawn = pictures(result)
            for (order, _, log), flight in zip(begun, running, strict=True):
                predicted_m = predict(order.planned.plan, order.feedforward)
                try:
                    flight.result()
                except FAILURES as error:
                    landed[order] = None, self._failed(error)
                    figures.append(f"{order.label}: {landed[order][1]}")
                else:
                    self._later.append(read_flight(log))
                    again = tracked(
                        order.label,
                        self._later[-1],
                        order.planned,
                        latency_s=latency_of(result),
                        predicted_rmse_m=predicted_m,
                    )
                    landed[order] = again, ""
                    figures.append(f"{order.label} {1e3 * again.rmse_m:.1f} mm")
                bar.advance()
            done(f"tracking error RMSE first {1e3 * pooled_rmse_m(first):.1f} mm, {', '.join(figures)}")
        return landed, drawn

    def _plan_again(
        self, route: Planned, model: Model, predict: Callable[[Plan], float]
    ) -> tuple[Planned | None, str]:
        """Return the route's second plan and an empty reason, or None and the reason."""
        with self._steps.step("plan again") as (_, done):
            if not ResidualModel.of(model, self._effects).has_force:
                why = f"{', '.join(model.effects)}: not a drag that another path could avoid"
                done(f"no new plan: {why}")
                return None, why
            try:
                choice = plan_again(route, self._request.vehicle, model, self._effects, predict)
            except FAILURES as error:
                why = self._failed(error)
                done(f"no new plan: {why}")
                return None, why
            planned = choice.planned
            self._files.write_plan(planned, model)
            before_mm, after_mm = 1e3 * predict(route.plan), 1e3 * choice.predicted_rmse_m
            done(
                f"route {route.name} with the traced model, the best of {choice.plans} plans in the same "
                f"{planned.plan.duration_s:.1f} s; predicted tracking error {before_mm:.1f} to "
                f"{after_mm:.1f} mm RMSE"
            )
        return planned, ""

    def _report(
        self,
        result: Trace,
        comparison: Comparison,
        used: list[tuple[Planned, Flight]],
        unseen: list[tuple[Planned, Flight]],
        drawn: Sequence[Figure],
    ) -> dict[str, Any]:
        with self._steps.step("report") as (_, done):
            answer = to_json(result, model_path=MODEL_NAME, report_path=REPORT_NAME) | comparison.to_json()
            flights, held_out = [flight for _, flight in used], [flight for _, flight in unseen]
            shown = report.compared(shown_flights(result, flights, held_out, self._later), comparison)
            html = page(
                result,
                flights,
                held_out,
                shown,
                answer,
                drawn,
                report.sections(comparison, result, self._request.vehicle, titles_of(shown)),
            )
            self._files.write(REPORT_NAME, html)
            self._files.write(JSON_NAME, json_text(answer) + "\n")
            done(f"one file of {len(html.encode()) / 1024:.0f} KiB")
        folder = self._request.folder
        return answer | {
            "model": str(folder / MODEL_NAME),
            "report": str(folder / REPORT_NAME),
            "truth": str(folder / TRUTH_PAGE),
        }

    # Parts of steps.

    def _next_flight(self, planned: Planned) -> tuple[int, Path]:
        """Return the number and the log of the next flight."""
        self._flights += 1
        return self._flights, self._files.log(self._flights, planned)

    def _failed(self, error: TrimtabError) -> str:
        """Return the error's text without the folder's path; the first error decides the demo's exit code."""
        self._failures.append(error)
        return str(error).replace(f"{self._request.folder}{os.sep}", "")
