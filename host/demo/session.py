"""One demo: plan, upload, fly, trace, plan again, fly again, report. Each step is timed and says a figure."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from host import artefacts
from host.demo import report
from host.demo.compare import Comparison, latency_of, tracked
from host.demo.flights import Airfield, upload_through_pty
from host.demo.plans import Planned, fastest, plan_again, plan_first
from host.demo.predict import predicted_rmse_m
from host.demo.routes import DemoRoutes, draw_routes
from host.demo.seeds import host_seed, world_seed
from host.effects import Effect, compose_feedforward
from host.log import Flight, read_flight
from host.models.file import write_model
from host.models.model import Model
from host.output import json_text
from host.plan import Plan, write_plan
from host.progress import Progress
from host.report.trace import page
from host.trace.result import Trace
from host.trace.run import Manoeuvres, run
from host.vehicle import Vehicle
from protocol.blobs import BLOCK_FIELDS, FeedForward

WORLD = "drawn-several"
TWINS = 2
MODEL_NAME, REPORT_NAME, JSON_NAME, FEEDFORWARD_NAME = (
    "demo.model.toml",
    "demo.html",
    "demo.json",
    "applied.ff",
)

Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class DemoOrder:
    """What to show, and where to leave it.

    folder: gets every file, made if missing; `force` overwrites. routes: drawn from the seed where None.
    twins: flights of each reference to learn from.
    """

    vehicle: Vehicle
    folder: Path
    seed: int
    world: str = WORLD
    routes: DemoRoutes | None = None
    twins: int = TWINS
    force: bool = False


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What the demo found: the trace, the flown comparison, and the JSON object without wall time."""

    result: Trace
    comparison: Comparison
    answer: Mapping[str, Any]
    steps: tuple[tuple[str, float], ...]


def run_demo(
    order: DemoOrder,
    effects: Mapping[str, Effect],
    *,
    say: Say = lambda line: None,
    manoeuvres: Manoeuvres | None = None,
) -> Outcome:
    """The outcome of a demo; files are in the folder.

    Raises ConfigurationError (no such world), Refused or PlanUnsolved (a plan), FlightFailed (a failsafe), or
    what tracing raises; flights finished by then have left readable logs.
    """
    return _Demo(order, effects, say, manoeuvres).run()


class _Demo:
    def __init__(
        self, order: DemoOrder, effects: Mapping[str, Effect], say: Say, manoeuvres: Manoeuvres | None
    ) -> None:
        self._order = order
        self._effects = effects
        self._say = say
        self._manoeuvres = manoeuvres
        self._seed = host_seed(order.seed)
        self._routes = order.routes or draw_routes(self._seed, order.vehicle.limits)
        self._field = Airfield(
            vehicle=order.vehicle,
            world=order.world,
            world_seed=world_seed(order.seed),
            session=self._told(),
        )
        self._flights = 0
        self._steps: list[tuple[str, float]] = []

    def run(self) -> Outcome:
        self._field.check()
        self._order.folder.mkdir(parents=True, exist_ok=True)
        learning, held_out = self._plan()
        used, unseen = self._fly(learning, held_out)
        result = self._trace([flight for _, flight in used], [flight for _, flight in unseen])
        model_path = self._order.folder / MODEL_NAME
        write_model(result.model, model_path, force=self._order.force)
        comparison = self._again(learning, used, result)
        answer = self._report(result, comparison, used, unseen)
        return Outcome(result=result, comparison=comparison, answer=answer, steps=tuple(self._steps))

    # The steps.

    def _plan(self) -> tuple[list[Planned], list[Planned]]:
        routes = (*self._routes.learning, *self._routes.held_out)
        with self._step("plan", len(routes)) as (bar, done):
            plans = []
            for route in routes:
                bar.advance(0.0, route.name)
                planned = plan_first(route, self._order.vehicle)
                self._write_plan(planned)
                plans.append(planned)
                bar.advance()
            seconds = sum(planned.plan.duration_s for planned in plans)
            done(f"{len(plans)} references with the nominal model, {seconds:.0f} s to fly")
        count = len(self._routes.learning)
        return plans[:count], plans[count:]

    def _fly(
        self, learning: list[Planned], held_out: list[Planned]
    ) -> tuple[list[tuple[Planned, Flight]], list[tuple[Planned, Flight]]]:
        """Every planned flight; the first reference goes on board through a pty, the others in lock-step."""
        field, first = self._field, learning[0]
        reference = first.plan.reference
        with self._step("upload") as (bar, done):
            simulated = field.power_up(reference, 1)
            bar.advance(0.0, first.name)
            port, sent = upload_through_pty(simulated, reference)
            done(
                f"reference {first.name} through pyserial at {port}: {len(reference.to_bytes())} B in "
                f"{sent.frames_sent} frames, checked on board and live"
            )
        flown: list[tuple[Planned, Flight]] = []
        every = [planned for planned in learning for _ in range(self._order.twins)] + held_out
        with self._step("fly", len(every)) as (bar, done):
            for planned in every:
                bar.advance(0.0, planned.name)
                if not flown:
                    flown.append((planned, self._first_flight(simulated, planned)))
                else:
                    flown.append((planned, self._flight(planned)))
                bar.advance()
            count = len(every) - len(held_out)
            errors = [tracked("", f, p, latency_s=0.0).stamped_rmse_m for p, f in flown]
            done(
                f"{count} flights to learn from (the first with what the pty left on board, the others "
                f"uploaded over the simulated link) and {len(held_out)} held out; tracking error "
                f"{1e3 * float(np.mean(errors)):.0f} mm RMSE on average"
            )
        return flown[:count], flown[count:]

    def _trace(self, used: list[Flight], held_out: list[Flight]) -> Trace:
        with self._step("trace") as (bar, done):
            result = run(
                used,
                held_out,
                self._effects,
                vehicle=self._order.vehicle,
                manoeuvres=self._manoeuvres,
                provenance=artefacts.provenance(
                    seed=self._seed,
                    parents={f"log {i}": flight.id for i, flight in enumerate(used)},
                    argv=self._argv(),
                ),
                report=lambda doing: bar.advance(0.0, doing),
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
    ) -> Comparison:
        """The fastest route again, with the traced model, where there is one."""
        route = fastest(learning)
        latency_s = latency_of(result)
        first = tuple(
            tracked(f"first flight {i}", flight, planned, latency_s=latency_s)
            for i, (planned, flight) in enumerate((pair for pair in used if pair[0] is route), start=1)
        )
        comparison = Comparison(first=first, new_plan=None, applied=None, latency_s=latency_s)
        if not result.effects:
            return comparison
        model = result.model
        like = next(flight for planned, flight in used if planned is route)

        def predict(plan: Plan, feedforward: FeedForward | None = None) -> float:
            return predicted_rmse_m(like, plan.reference, model, self._effects, feedforward)

        with self._step("plan again") as (_, done):
            choice = plan_again(route, self._order.vehicle, model, self._effects, predict)
            planned = choice.planned
            self._write_plan(planned, model)
            before_mm, after_mm = 1e3 * predict(route.plan), 1e3 * choice.predicted_rmse_m
            done(
                f"route {route.name} with the traced model, the best of {choice.plans} plans in the same "
                f"{planned.plan.duration_s:.1f} s; predicted tracking error {before_mm:.1f} to "
                f"{after_mm:.1f} mm RMSE"
            )
        feedforward = feedforward_of(model, self._order.vehicle, self._effects)
        artefacts.write_atomic(
            self._order.folder / FEEDFORWARD_NAME, feedforward.to_bytes(), self._order.force
        )
        flown = []
        for label, addition in (("new plan", None), ("new plan, effects applied", feedforward)):
            with self._step("fly again") as (_, done):
                predicted_m = predict(planned.plan, addition)
                flight = self._flight(planned, addition, model.id)
                found = tracked(label, flight, planned, latency_s=latency_s, predicted_rmse_m=predicted_m)
                flown.append(found)
                before_mm, after_mm = 1e3 * comparison.first_rmse_m, 1e3 * found.rmse_m
                done(f"{label}: tracking error {before_mm:.1f} to {after_mm:.1f} mm RMSE")
        return replace(comparison, new_plan=flown[0], applied=flown[1])

    def _report(
        self,
        result: Trace,
        comparison: Comparison,
        used: list[tuple[Planned, Flight]],
        unseen: list[tuple[Planned, Flight]],
    ) -> dict[str, Any]:
        folder, force = self._order.folder, self._order.force
        with self._step("report") as (_, done):
            found = result.to_json(model_path=MODEL_NAME, report_path=REPORT_NAME) | comparison.to_json()
            html = page(
                result,
                [flight for _, flight in used],
                [flight for _, flight in unseen],
                found,
                report.sections(comparison, result, self._order.vehicle),
            )
            artefacts.write_atomic(folder / REPORT_NAME, html, force)
            artefacts.write_atomic(folder / JSON_NAME, json_text(found) + "\n", force)
            done(f"one file of {len(html.encode()) / 1024:.0f} KiB")
        return found | {"model": str(folder / MODEL_NAME), "report": str(folder / REPORT_NAME)}

    # Parts of steps.

    def _first_flight(self, simulated: Any, planned: Planned) -> Flight:
        """The flight with what is on board: the vehicle starts from power-up, its memory kept."""
        self._flights += 1
        simulated.power_cycle(self._flights)
        log = self._log(planned)
        self._field.fly_with(simulated, planned.plan.reference, self._flights, log)
        simulated.close()
        return read_flight(log)

    def _flight(
        self, planned: Planned, feedforward: FeedForward | None = None, model_id: str | None = None
    ) -> Flight:
        self._flights += 1
        log = self._log(planned)
        self._field.fly(
            planned.plan.reference, self._flights, log, feedforward=feedforward, model_id=model_id
        )
        return read_flight(log)

    def _log(self, planned: Planned) -> Path:
        return artefacts.check_log(
            self._order.folder / f"{self._flights:02d}-{planned.name}.mcap", self._order.force
        )

    def _write_plan(self, planned: Planned, model: Model | None = None) -> None:
        parents = {"vehicle": self._order.vehicle.id, "route": planned.route.id}
        if model is not None:
            parents["model"] = model.id
        write_plan(
            planned.plan,
            self._order.folder / f"{planned.name}.ref",
            provenance=artefacts.provenance(seed=self._seed, parents=parents, argv=self._argv()),
            force=self._order.force,
        )

    def _argv(self) -> list[str]:
        """The command without world, seed and folder, which artefacts do not tell."""
        return ["demo", "--vehicle", self._order.vehicle.name]

    def _told(self) -> dict[str, str]:
        """What the logs say of the session."""
        known = artefacts.provenance(seed=self._seed, argv=self._argv())
        return {
            key: str(known[key]) for key in ("version", "git", "command", "seed") if known[key] is not None
        }

    @contextmanager
    def _step(
        self, title: str, total: float | None = None
    ) -> Iterator[tuple[Progress, Callable[[str], None]]]:
        """Times a step and says its line; the figure of it is told to the second of what is yielded."""
        figures: list[str] = []
        begin_s = time.perf_counter()
        with Progress(title, total) as bar:
            yield bar, figures.append
        seconds = time.perf_counter() - begin_s
        self._steps.append((title, seconds))
        self._say(f"{len(self._steps)}. {title} ({seconds:.1f} s): {figures[0]}")


def feedforward_of(model: Model, vehicle: Vehicle, effects: Mapping[str, Effect]) -> FeedForward:
    """The model's named effects as far as the law can apply them."""
    numbers = compose_feedforward(model.parts(effects, use="effects"))
    block: list[float] = []
    for name, size in BLOCK_FIELDS:
        block += [numbers[name]] if size == 1 else list(numbers[name])
    return FeedForward(vehicle_id=vehicle.id, model_id=model.id, block=tuple(block))
