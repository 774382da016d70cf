"""The MPC with a network in its prediction: processor time of its steps, beside the same problem by Ipopt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_multiply, quat_normalize
from trimtab.host.apps.bench.naive_mpc import NaiveMpc
from trimtab.host.apps.bench.planning import drag_model, draw_courses
from trimtab.host.control.closed_loop import ControlledFlight, Plant, fly
from trimtab.host.control.dynamics import ControlModel
from trimtab.host.control.files import load_controller
from trimtab.host.control.interface import ControlStep, RateCommand, SolveStatus, StateEstimate
from trimtab.host.control.mpc import Mpc, cost_parameters
from trimtab.host.control.settings import MpcSettings
from trimtab.host.control.solver import TrackingSolver
from trimtab.host.models.model import Model
from trimtab.host.models.reference import flat_outputs
from trimtab.host.plan import plan
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import Reference

Array = NDArray[np.float64]

CONTROLLER = "mpc-neural"
_HIDDEN = (32, 32, 32)
_FIT_ITERATIONS = 60
_SIGMA = {"p_ned": 1e-3, "v_ned": 0.02, "rate_frd": 0.02}
"""Noise of the estimates: m, m/s, rad/s."""
_TURN_SIGMA = 0.005
"""Noise of the attitude, rad about each axis."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """Size of the measurement: control steps, courses to fly them on, and problems for the peer."""

    steps: int = 100_000
    courses: int = 10
    peer_problems: int = 100

    def peers_alone(self) -> Size:
        """Return the same problems for the peer, after a single flight."""
        return replace(self, steps=1, courses=1)


QUICK = Size(steps=10_000, courses=4, peer_problems=30)
STEPS = ("MPC, steps", "MPC, CasADi and Ipopt")


def measure(
    vehicle: Vehicle,
    seed: int,
    on_progress: Callable[[str], None] = lambda step: None,
    *,
    size: Size | None = None,
) -> dict[str, Any]:
    """Return processor times of the steps of CONTROLLER, the outcome of its solves, and the peer's times.

    mpc_solve_ms_p99: of the solver alone, from the plan before, over all states of a flight with noise. The
    vehicle has the drag that the network is fitted to, and every estimate has noise. `on_progress` is called
    with each of STEPS as it begins.
    """
    size = size or Size()
    settings = load_controller(CONTROLLER)
    assert isinstance(settings, MpcSettings)
    network = drag_model(vehicle, seed, hidden=_HIDDEN, iterations=_FIT_ITERATIONS)[0].network
    model = Model(vehicle_id=vehicle.id, vehicle_name=vehicle.name, network=network)
    of_plant = ControlModel.of(vehicle, settings.rate_lag_s, model)
    timed = _Timed(Mpc(settings, vehicle, model=model), np.random.default_rng([seed, 1]))
    courses = draw_courses(vehicle, seed, size.courses)
    references = [plan(course, vehicle, kind="min-snap").reference for course in courses]
    on_progress(STEPS[0])
    errors: list[float] = []
    flight: ControlledFlight | None = None
    for reference in cycle(references):
        flight = fly(timed, Plant(of_plant), reference)
        errors.append(float(flight.error_m.mean()))
        if len(timed.times_s) >= size.steps:
            break
    assert flight is not None
    solver = _solver(of_plant, settings)
    problems = _problems(solver, of_plant, settings, references[0], np.random.default_rng([seed, 2]))
    solves = _solve(solver, settings, problems)
    on_progress(STEPS[1])
    statuses = [step.status for step in timed.steps]
    spent = statuses.count(SolveStatus.BUDGET_SPENT)
    p50, p99 = (float(1e3 * np.percentile(timed.times_s, share)) for share in (50, 99))
    return {
        "controller": CONTROLLER,
        "hidden": list(_HIDDEN),
        "stages": settings.stages,
        "steps": len(statuses),
        "mpc_step_ms_p50": p50,
        "mpc_step_ms_p99": p99,
        "mpc_solve_ms_p99": 1e3 * float(np.percentile([seconds for seconds, _ in solves], 99)),
        "iterations_mean": float(np.mean([step.iterations for step in timed.steps])),
        "budget_spent": spent,
        "budget_spent_share": spent / len(statuses),
        "infeasible": statuses.count(SolveStatus.INFEASIBLE),
        "error_mean_m": float(np.mean(errors)),
        "naive": _beside(of_plant, settings, problems[: size.peer_problems], solves),
    }


def _solver(model: ControlModel, settings: MpcSettings) -> TrackingSolver:
    cost = cost_parameters(settings, model)
    return TrackingSolver(
        model, stages=settings.stages, step_s=settings.step_s, cost=cost, tolerance=settings.tolerance
    )


def _problems(
    solver: TrackingSolver,
    model: ControlModel,
    settings: MpcSettings,
    reference: Reference,
    rng: np.random.Generator,
) -> list[tuple[Array, Array]]:
    """Return state, with noise, and targets of consecutive steps: a flight of the nominal controller."""
    nominal = settings.model_copy(update={"residual": "none"})
    flight = fly(Mpc(nominal, model.vehicle), Plant(model), reference)
    horizon_s = settings.step_s * np.arange(settings.stages + 1)
    sigma = np.repeat(
        [*(_SIGMA[name] for name in ("p_ned", "v_ned")), _TURN_SIGMA, _SIGMA["rate_frd"], 0.0],
        [3, 3, 3, 3, 1],
    )
    return [
        (x + sigma * rng.standard_normal(len(x)), solver.targets(flat_outputs(reference, t_s + horizon_s)))
        for x, t_s in zip(flight.x, flight.t_s, strict=True)
    ]


def _solve(
    solver: TrackingSolver, settings: MpcSettings, problems: Sequence[tuple[Array, Array]]
) -> list[tuple[float, Array | None]]:
    """Return the processor time of each problem, from the plan of the one before, and its first input."""
    solved, start = [], solver.start(problems[0][1])
    for x0, targets in problems:
        began = process_time()
        plan = solver.solve(x0, targets, start, iterations_max=settings.iterations_max).plan
        solved.append((process_time() - began, None if plan is None else plan.u[0]))
        start = solver.start(targets) if plan is None else plan.shifted(1)
    return solved


def _beside(
    model: ControlModel,
    settings: MpcSettings,
    problems: Sequence[tuple[Array, Array]],
    solves: Sequence[tuple[float, Array | None]],
) -> dict[str, Any]:
    """Return the times of both solvers on the same problems, and their difference."""
    cost = cost_parameters(settings, model)
    naive = NaiveMpc(model, stages=settings.stages, step_s=settings.step_s, cost=cost)
    low, high = model.input_bounds()
    times_s: list[float] = []
    differs, failed = 0.0, 0
    for (x0, targets), (_, ours) in zip(problems, solves, strict=False):
        began = process_time()
        expected = naive.solve(x0, targets)
        times_s.append(process_time() - began)
        if expected is None or ours is None:
            failed += 1
            continue
        differs = max(differs, float((np.abs(ours - expected) / (high - low)).max()))
    ours_ms = 1e3 * float(np.median([seconds for seconds, _ in solves[: len(problems)]]))
    naive_ms = 1e3 * float(np.median(times_s))
    return {
        "problems": len(times_s),
        "ms": naive_ms,
        "ours_ms": ours_ms,
        "over_ours": naive_ms / ours_ms,
        "differs": differs,
        "failed": failed,
    }


class _Timed:
    """A controller that gets noisy estimates, with the processor time (s) of its steps and their results."""

    def __init__(self, inner: Mpc, rng: np.random.Generator) -> None:
        self._inner, self._rng = inner, rng
        self.times_s: list[float] = []
        self.steps: list[ControlStep] = []

    @property
    def period_us(self) -> int:
        return self._inner.period_us

    def begin(self, reference: Reference) -> None:
        self._inner.begin(reference)

    def step(self, estimate: StateEstimate, sent: Sequence[RateCommand], act_us: int) -> ControlStep:
        noisy = self._with_noise(estimate)
        began = process_time()
        step = self._inner.step(noisy, sent, act_us)
        self.times_s.append(process_time() - began)
        self.steps.append(step)
        return step

    def _with_noise(self, estimate: StateEstimate) -> StateEstimate:
        p, v, rate = (
            tuple(np.add(getattr(estimate, name), sigma * self._rng.standard_normal(3)).tolist())
            for name, sigma in _SIGMA.items()
        )
        half = 0.5 * _TURN_SIGMA * self._rng.standard_normal(3)
        turn = quat_normalize(FLOAT, (1.0, *half.tolist()))
        w, x, y, z = quat_multiply(estimate.q_ned_frd, turn)
        return estimate._replace(p_ned=p, v_ned=v, q_ned_frd=(w, x, y, z), rate_frd=rate)
