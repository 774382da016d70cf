"""The controllers: tracking, disturbances, prediction over delay, and what they refuse."""

from __future__ import annotations

import functools
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.host.control.examples import EFFECTS, NETWORK, VEHICLE, drag_model, reference, settings
from tests.narrowing import not_none
from trimtab.host.base.errors import UsageError
from trimtab.host.control.closed_loop import DELAY_US, ControlledFlight, Plant, estimate_of, fly, hover_at
from trimtab.host.control.dynamics import ControlModel
from trimtab.host.control.interface import ControlStep, RateCommand, SolveStatus, StateEstimate
from trimtab.host.control.mpc import Mpc
from trimtab.host.models.airframe import P
from trimtab.host.plan import plan
from trimtab.host.route import load_route
from trimtab.host.vehicle import load_vehicle

NOMINAL = ControlModel.of(VEHICLE)
DRAGGED = ControlModel.of(VEHICLE, None, drag_model(), EFFECTS)
WEIGHT_N = NOMINAL.weight_n
_ZERO = (0.0, 0.0, 0.0)


@functools.cache
def _controller(name: str) -> Mpc:
    model = drag_model() if settings(name).residual == "model" else None
    return Mpc(settings(name), VEHICLE, model=model, effects=EFFECTS)


@functools.cache
def _flown(name: str, *, drag: bool) -> ControlledFlight:
    return fly(_controller(name), Plant(DRAGGED if drag else NOMINAL), reference())


def _commands(flown: ControlledFlight) -> np.ndarray:
    """All commands (n, 4) of a flight."""
    sent = [step.command for step in flown.steps if step.command is not None]
    return np.array([[*command.rate_frd, command.collective_n] for command in sent])


def _first_step(controller: Mpc, act_us: int = DELAY_US) -> ControlStep:
    """The first step of a flight, from hover at the start of the reference."""
    controller.begin(reference())
    sent = [RateCommand(-1_000_000, (0.0, 0.0, 0.0), WEIGHT_N)]
    return controller.step(estimate_of(hover_at(reference(), WEIGHT_N), 0), sent, act_us)


def test_nominal_controller_follows_the_nominal_vehicle_to_a_millimetre() -> None:
    flown = _flown("mpc", drag=False)
    assert {step.status for step in flown.steps} == {SolveStatus.SOLVED}
    assert flown.error_m.max() < 1e-3


def test_controllers_rank_under_drag_as_in_the_paper() -> None:
    nominal, adaptive, hybrid = (
        _flown(name, drag=True).error_m.mean() for name in ("mpc", "mpc-l1", "mpc-neural")
    )
    assert hybrid < 0.1 * adaptive
    assert adaptive < 0.6 * nominal


def test_adaptive_controller_has_no_offset_in_constant_wind_and_nominal_has() -> None:
    wind = (0.8, -0.5, 0.3)
    at_rest = {}
    for name in ("mpc", "mpc-l1"):
        flown = fly(_controller(name), Plant(NOMINAL, wind), reference("hover"), hold_us=6_000_000)
        at_rest[name] = flown.error_m[-1]
    assert at_rest["mpc"] > 0.01
    assert at_rest["mpc-l1"] < 1e-5


def test_controller_with_network_cancels_the_same_network_in_the_plant() -> None:
    model = drag_model(NETWORK)
    controller = Mpc(settings("mpc-neural"), VEHICLE, model=model, effects=EFFECTS)
    plant = Plant(ControlModel.of(VEHICLE, None, model, EFFECTS))
    known = fly(controller, plant, reference()).error_m.mean()
    without = fly(_controller("mpc-neural"), plant, reference()).error_m.mean()
    assert known < 0.1 * without


def test_same_calls_give_the_same_commands() -> None:
    first = _commands(_flown("mpc-l1", drag=True))
    again = _commands(fly(_controller("mpc-l1"), Plant(DRAGGED), reference()))
    assert first.tobytes() == again.tobytes()


def test_commands_without_a_compiler_are_nearly_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    route = load_route("hover", None, VEHICLE).model_copy(update={"total_time_s": 4.0})
    hover = plan(route, VEHICLE, stretch=True).reference
    compiled = fly(_controller("mpc-neural"), Plant(DRAGGED), hover)
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    controller = Mpc(settings("mpc-neural"), VEHICLE, model=drag_model(), effects=EFFECTS)
    machine = fly(controller, Plant(DRAGGED), hover)
    low, high = NOMINAL.input_bounds()
    assert (np.abs(_commands(compiled) - _commands(machine)) <= 5e-4 * (high - low)).all()


def test_commands_stay_within_what_the_vehicle_executes() -> None:
    low, high = NOMINAL.input_bounds()
    x0 = hover_at(reference(), WEIGHT_N)
    x0[P] += (2.0, -2.0, 1.5)
    flown = fly(_controller("mpc"), Plant(NOMINAL), reference(), x0=x0)
    commands = _commands(flown)
    assert ((commands >= low) & (commands <= high)).all()
    assert (np.abs(commands[:, :3]) > 0.999 * high[:3]).any()
    assert flown.error_m[-1] < 1e-3


def test_prediction_over_the_delay_matters() -> None:
    # The same flight by a controller that is told that its commands act at once.
    class Undelayed:
        def __init__(self, inner: Mpc) -> None:
            self._inner = inner
            self.period_us, self.begin = inner.period_us, inner.begin

        def step(self, estimate: StateEstimate, sent: list[RateCommand], act_us: int) -> ControlStep:
            step = self._inner.step(estimate, sent, act_us - 2 * DELAY_US)
            late = not_none(step.command)._replace(t_us=act_us)
            return ControlStep(command=late, status=step.status, iterations=step.iterations)

    plant = Plant(NOMINAL)
    undelayed = fly(Undelayed(_controller("mpc")), plant, reference())  # type: ignore[arg-type]
    assert _flown("mpc", drag=False).error_m.mean() < 0.1 * undelayed.error_m.mean()


def test_command_sent_before_the_step_is_part_of_the_prediction() -> None:
    controller = _controller("mpc")
    roll = []
    for rate in (0.0, 2.0):
        controller.begin(reference())
        sent = [RateCommand(-1_000_000, (0.0, 0.0, 0.0), WEIGHT_N), RateCommand(5_000, (rate, 0.0, 0.0), 8.0)]
        step = controller.step(estimate_of(hover_at(reference(), WEIGHT_N), 0), sent, 40_000)
        roll.append(not_none(step.command).rate_frd[0])
    assert roll[1] < roll[0] - 0.5


def test_late_command_acts_at_the_stated_time() -> None:
    step = _first_step(_controller("mpc"), act_us=400_000)
    assert step.status is SolveStatus.SOLVED
    assert not_none(step.command).t_us == 400_000


def test_command_later_than_the_horizon_is_refused() -> None:
    step = _first_step(_controller("mpc"), act_us=600_000)
    assert (step.command, step.status) == (None, SolveStatus.INFEASIBLE)


def test_refused_steps_continue_the_last_plan_until_it_ends() -> None:
    controller = _controller("mpc")
    assert _first_step(controller).status is SolveStatus.SOLVED
    broken = StateEstimate(25_000, (math.nan, 0.0, 0.0), _ZERO, (1.0, 0.0, 0.0, 0.0), _ZERO)
    stages = controller.settings.stages
    steps = [controller.step(broken, (), DELAY_US + k * controller.period_us) for k in range(stages + 1)]
    assert {step.status for step in steps} == {SolveStatus.INFEASIBLE}
    assert all(step.command is not None for step in steps[:-1])
    assert steps[-1].command is None
    for earlier, later in pairwise(steps[:-1]):
        assert not_none(later.command).t_us - not_none(earlier.command).t_us == controller.period_us


def test_spent_budget_continues_the_last_solved_plan() -> None:
    small = Mpc(settings().model_copy(update={"iterations_max": 8}), VEHICLE)
    first = _first_step(small)
    assert first.status is SolveStatus.SOLVED
    far = hover_at(reference(), WEIGHT_N)
    far[P] += 1.0
    step = small.step(estimate_of(far, 25_000), [not_none(first.command)], DELAY_US + 25_000)
    assert step.status is SolveStatus.BUDGET_SPENT
    plan = not_none(step.command)
    refused = small.step(estimate_of(far * math.nan, 25_000), (), DELAY_US + 25_000)
    assert not_none(refused.command) == plan


def test_after_its_end_the_last_node_is_held() -> None:
    flown = fly(_controller("mpc"), Plant(NOMINAL), reference(), hold_us=3_000_000)
    command = not_none(flown.steps[-1].command)
    assert flown.error_m[-1] < 1e-4
    np.testing.assert_allclose(command.rate_frd, 0.0, atol=1e-3)
    assert command.collective_n == pytest.approx(WEIGHT_N, rel=1e-3)


def test_yaw_beyond_half_a_turn_is_followed_without_a_turn_back() -> None:
    flown = fly(_controller("mpc"), Plant(NOMINAL), reference("fast-lemniscate"))
    assert flown.error_m.max() < 0.02


def test_step_before_begin_raises() -> None:
    with pytest.raises(RuntimeError):
        Mpc(settings(), VEHICLE).step(estimate_of(hover_at(reference(), WEIGHT_N), 0), (), 0)


@pytest.mark.parametrize("name", ["mpc", "mpc-neural"])
def test_model_must_go_with_the_settings(name: str) -> None:
    model = drag_model() if name == "mpc" else None
    with pytest.raises(UsageError, match="residual"):
        Mpc(settings(name), VEHICLE, model=model, effects=EFFECTS)


def test_model_of_another_vehicle_is_refused() -> None:
    with pytest.raises(UsageError, match="vehicle"):
        Mpc(settings("mpc-neural"), load_vehicle("nano"), model=drag_model(), effects=EFFECTS)


def test_nominal_controller_flies_every_shipped_vehicle() -> None:
    nano = load_vehicle("nano")
    course = plan(load_route("hover-turns", None, nano), nano, stretch=True).reference
    flown = fly(Mpc(settings(), nano), Plant(ControlModel.of(nano)), course)
    assert {step.status for step in flown.steps} == {SolveStatus.SOLVED}
    assert flown.error_m.max() < 0.01


_NUMBER = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-5.0, 5.0)
_TRIPLE = st.tuples(_NUMBER, _NUMBER, _NUMBER)
_UNIT = st.sampled_from(
    [(1.0, 0.0, 0.0, 0.0), (0.5, 0.5, 0.5, 0.5), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)]
)
_TIME = st.integers(-(10**7), 10**7)


@given(
    p=_TRIPLE,
    v=_TRIPLE,
    q=_UNIT | st.tuples(_NUMBER, _NUMBER, _NUMBER, _NUMBER),
    rate=_TRIPLE,
    command=st.tuples(_TRIPLE, _NUMBER),
    times=st.tuples(_TIME, _TIME, _TIME),
)
def test_step_never_raises(p, v, q, rate, command, times) -> None:
    controller = _controller("mpc-l1")
    controller.begin(reference())
    t_us, sent_us, act_us = times
    sent = [RateCommand(sent_us, *command)]
    low, high = NOMINAL.input_bounds()
    for offset in (0, 25_000):
        now = StateEstimate(t_us + offset, p, v, q, rate)
        step = controller.step(now, sent, act_us + offset)
        if step.command is not None:
            values = np.array([*step.command.rate_frd, step.command.collective_n])
            assert ((values >= low) & (values <= high)).all()
        else:
            assert step.status is not SolveStatus.SOLVED
