"""phi against an independent simulation of the sampled loop: accuracy, order, drives, lanes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.parts import part
from trimtab.firmware_model.law import feedforward as law_feedforward
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.step import integral_limit
from trimtab.host.codegen.batch import Batch
from trimtab.host.effects import load_effects
from trimtab.host.models.drive import (
    DRIVE_ROWS,
    ESTIMATED_THETA,
    FF_GAIN,
    VOLTAGE_AND_TIME,
    flight_constants,
)
from trimtab.host.models.network import Layout, Network
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.reference import block as block_of
from trimtab.host.models.reference import feedforward_rows, flat_outputs
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.vehicle import to_parameters
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward

EFFECTS = load_effects()
DRAG = part("linear-drag", 0.4, 0.35, 0.2)


def predict(
    phi, reference, parts=(), *, step_s=0.01, every=1, rows=12, feedforward=None, network=None, **constants
):
    """The first `rows` states (n, rows) of a whole flight from hover at the reference's start."""
    steps = round(reference.duration_us * 1e-6 / step_s)
    drive = reference_drive(reference, half_steps(0.0, steps, step_s), feedforward=feedforward)
    start = flat_outputs(reference, np.zeros(1))[:, 0]
    block = None if feedforward is None else block_of(feedforward)
    states = roll_out(
        phi,
        x0=phi.hover(start[0:3], start[12])[:, None],
        drive=drive,
        flight=flight_constants(block, **constants),
        theta=phi.theta(parts),
        step_s=step_s,
        every=every,
        network=network,
        rows=rows,
    )
    return states[:, :, 0]


def rmse(a, b):
    return float(np.sqrt(((a[:, :3] - b[:, :3]) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize(
    "parts",
    [
        (),
        (DRAG,),
        (part("thrust-gain", 0.9), part("com-offset", 0.004, -0.003)),
        (part("motor-lag", 0.02), part("quadratic-drag", 0.05)),
    ],
    ids=lambda parts: "+".join(effect.name for effect, _ in parts) or "nominal",
)
def test_phi_whole_flight_equals_the_sampled_loop(vehicle, make_reference, fly_sampled, parts):
    """Within 3 mm is asked for, with noise; without it the continuous form is far closer."""
    reference = make_reference(turning=True)
    phi = Phi(vehicle=vehicle, effects=tuple(effect for effect, _ in parts))
    flown = fly_sampled(reference, parts)
    predicted = predict(phi, reference, parts, mocap_age_s=0.012, mocap_interval_s=0.01)
    assert rmse(predicted, flown) < 0.1e-3
    reached = flat_outputs(reference, 0.01 * np.arange(len(flown)))[:3].T
    assert rmse(predicted, flown) < 0.05 * rmse(flown, reached)


def test_phi_with_the_integral_at_its_limit_equals_the_sampled_loop_and_has_slopes(
    vehicle, make_reference, fly_sampled
):
    """A rate that stopped at the limit would make a roll-out jump, and its difference quotients useless."""
    reference = make_reference(turning=True)
    effect = EFFECTS["com-offset"]
    phi = Phi(vehicle=vehicle, effects=(effect,))
    offset_m = 0.015  # the integral leaves its limit and returns
    limit = np.array(integral_limit(phi.firmware))

    def with_offset(y_m, rows=12):
        return predict(
            phi, reference, ((effect, (0.0, y_m, 2.0)),), rows=rows, mocap_age_s=0.012, mocap_interval_s=0.01
        )

    integral = with_offset(offset_m, rows=INTEGRAL.stop)[:, INTEGRAL.start]
    at_limit = np.abs(integral) >= limit[0]
    assert 0.1 < at_limit.mean() < 0.9
    assert np.abs(np.diff(at_limit.astype(int))).sum() >= 3
    assert np.abs(integral).max() < 1.01 * limit[0]
    flown = fly_sampled(reference, ((effect, (0.0, offset_m, 2.0)),))
    assert rmse(with_offset(offset_m), flown) < 0.1e-3
    coarse, fine = ((with_offset(offset_m + h) - with_offset(offset_m)) / h for h in (1e-5, 1e-7))
    np.testing.assert_allclose(fine, coarse, atol=0.1 * np.abs(coarse).max())


def observing(vehicle, bandwidth, **fields):
    return Phi(vehicle=vehicle, parameters=to_parameters(vehicle) | {"OBS_GAIN": bandwidth}, **fields)


@pytest.mark.parametrize(
    "parts",
    [
        (),
        (DRAG,),
        (part("thrust-gain", 0.9), part("motor-lag", 0.02)),
    ],
    ids=lambda parts: "+".join(effect.name for effect, _ in parts) or "nominal",
)
def test_phi_with_observer_equals_the_sampled_loop(vehicle, make_reference, fly_sampled, parts):
    reference = make_reference(turning=True)
    effects = tuple(effect for effect, _ in parts)
    flown = fly_sampled(reference, parts, observer=4.0)
    late = partial(predict, mocap_age_s=0.012, mocap_interval_s=0.01)
    predicted = late(observing(vehicle, 4.0, effects=effects), reference, parts)
    assert rmse(predicted, flown) < 0.1e-3
    off = late(Phi(vehicle=vehicle, effects=effects), reference, parts)
    if parts:
        assert rmse(off, flown) > 5e-3


def test_phi_with_observer_has_its_states_at_the_end_and_without_is_unchanged(vehicle):
    off = Phi(vehicle=vehicle, parameters=to_parameters(vehicle))
    assert not off.observes
    assert off.size == 31
    assert str(off.function) == str(observing(vehicle, 0.0).function)
    on = observing(vehicle, 4.0)
    assert on.size == on.observer.stop == 35
    assert on.vectors == (0, 3, 19, 22, 31)
    assert observing(vehicle, 4.0, drive="inputs").size == 16
    x = on.hover((0.0, 0.0, -1.0), 0.0)
    x[on.observer][:3] = (0.0, 0.0, 20.0)  # stands at its bound while what is seen would push it on
    drive = np.zeros(DRIVE_ROWS["reference"])
    drive[2], drive[FF_GAIN], drive[VOLTAGE_AND_TIME.start] = -1.0, 1.0, 1.0
    x[on.observer.stop - 1] = 30.0
    xdot = np.array(on.function(x, drive, flight_constants(), [], np.zeros(3))).ravel()
    np.testing.assert_allclose(xdot[on.observer][:2], 0.0, atol=1e-9)
    assert xdot[on.observer][2] <= 0.0


def test_phi_mocap_latency_equals_the_sampled_loop_with_late_poses(vehicle, make_reference, fly_sampled):
    reference = make_reference()
    late = part("mocap-latency", 0.02)
    flown = fly_sampled(reference, latency_s=0.02)
    phi = Phi(vehicle=vehicle, effects=(late[0],))
    predicted = predict(phi, reference, (late,), mocap_age_s=0.012, mocap_interval_s=0.01)
    ignored = predict(phi, reference, (), mocap_age_s=0.012, mocap_interval_s=0.01)
    assert rmse(ignored, flown) > 5e-3
    assert rmse(predicted, flown) < 0.3e-3


@pytest.mark.parametrize(("delay_s", "within"), [(0.0, 0.002), (0.006, 0.006), (0.012, 0.022)])
def test_phi_actuation_delay_equals_the_sampled_loop(vehicle, make_reference, fly_sampled, delay_s, within):
    """Body rates in a quick flight, rad/s: with the tick's hold as a lag they would be off twice as far."""
    reference = make_reference(size=2.0)
    late = part("actuation-delay", delay_s)
    flown = fly_sampled(reference, delay_ticks=round(1000 * delay_s))
    phi = Phi(vehicle=vehicle, effects=(late[0],))
    predicted = predict(phi, reference, (late,), mocap_age_s=0.012, mocap_interval_s=0.01)
    rates = np.sqrt(np.square(predicted - flown)[:, 9:].sum(axis=1).mean())
    assert rates < within


def test_phi_prediction_time_undoes_a_latency(vehicle, make_reference):
    reference = make_reference()
    late = part("mocap-latency", 0.02)
    phi = Phi(vehicle=vehicle, effects=(late[0],))
    block = list(NEUTRAL_BLOCK)
    block[law_feedforward.PREDICTION_TIME] = 0.02
    corrected = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=tuple(block))
    nominal = predict(phi, reference)
    assert rmse(predict(phi, reference, (late,)), nominal) > 5e-3
    assert rmse(predict(phi, reference, (late,), feedforward=corrected), nominal) < 1.5e-3


def test_phi_feedforward_of_the_true_drag_brings_the_flight_back(vehicle, make_reference, fly_sampled):
    reference = make_reference()
    block = list(NEUTRAL_BLOCK)
    block[law_feedforward.LINEAR] = DRAG[1][:3]
    fed = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=tuple(block))
    phi = Phi(vehicle=vehicle, effects=(DRAG[0],))
    flown = fly_sampled(reference, (DRAG,), feedforward=block_of(fed))
    predicted = predict(phi, reference, (DRAG,), feedforward=fed, mocap_age_s=0.012, mocap_interval_s=0.01)
    assert rmse(predicted, flown) < 0.1e-3
    nominal = predict(phi, reference)
    assert rmse(predicted, nominal) < 0.2 * rmse(predict(phi, reference, (DRAG,)), nominal)


def test_phi_smooth_reference_converges_with_order_four(vehicle, make_reference):
    reference = make_reference(duration_s=4.0)
    phi = Phi(vehicle=vehicle, effects=(DRAG[0],), estimator=False)
    truth = predict(phi, reference, (DRAG,), step_s=0.002, every=10)
    errors = [
        np.abs(predict(phi, reference, (DRAG,), step_s=h, every=round(0.02 / h)) - truth)[:, :6].max()
        for h in (0.02, 0.01, 0.005)
    ]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 3.6).all(), (errors, orders)
    assert errors[0] < 1e-4


def test_phi_feedback_delay_of_nothing_is_the_plain_loop_and_acts_to_first_order(vehicle, make_reference):
    reference = make_reference(duration_s=4.0)
    phi = Phi(vehicle=vehicle, estimator=False)
    plain = predict(phi, reference)
    small = predict(phi, reference, feedback_delay_s=0.001) - plain
    double = predict(phi, reference, feedback_delay_s=0.002) - plain
    assert 1e-4 < np.abs(small[:, :3]).max() < 0.01
    np.testing.assert_allclose(double[:, :3], 2.0 * small[:, :3], atol=0.05 * np.abs(double).max())


def test_phi_lanes_equal_casadi_and_floats(vehicle, make_reference):
    phi = observing(vehicle, 4.0, effects=tuple(EFFECTS.values()))
    rng = np.random.default_rng(5)
    bound = Batch(phi.function, 3)
    start = flat_outputs(make_reference(), np.full(3, 1.7))
    bound.inputs["x"][:] = 0.05 * rng.standard_normal((phi.size, 3))
    bound.inputs["x"][12:16] += 1.9
    bound.inputs["drive"][:14] = start
    bound.inputs["drive"][FF_GAIN] = 1.1
    bound.inputs["drive"][VOLTAGE_AND_TIME.start] = 0.95
    bound.inputs["flight"][:] = flight_constants(mocap_age_s=0.01)[:, None]
    bound.inputs["theta"][:] = phi.theta_neutral[:, None] * 1.01 + 0.001
    bound()
    for lane in range(3):
        columns = [array[:, lane].tolist() for array in bound.inputs.values()]
        symbolic = np.array(phi.function(*columns)).ravel()
        np.testing.assert_allclose(bound.outputs["xdot"][:, lane], symbolic, rtol=1e-10, atol=1e-11)
        np.testing.assert_allclose(phi.derivative(FLOAT, *columns), symbolic, rtol=1e-10, atol=1e-11)


def test_phi_estimate_drive_retraces_the_observer_of_a_reference_driven_flight(vehicle, make_reference):
    """Fed the states of a flight under drag, from its middle on, it gives d_hat and the thrust behind it."""
    reference = make_reference(duration_s=3.0)
    h, begin, end = 0.005, 200, 360
    whole = observing(vehicle, 4.0, effects=(DRAG[0],), estimator=False)
    start = flat_outputs(reference, np.zeros(1))[:, 0]
    roll = partial(roll_out, flight=flight_constants(), theta=np.array(DRAG[1]))
    fine = roll(
        whole,
        x0=whole.hover(start[:3].tolist(), 0.0)[:, None],
        drive=reference_drive(reference, half_steps(0.0, 2 * end, 0.5 * h)),
        step_s=0.5 * h,
        rows=whole.size,
    )[2 * begin :, :, 0]
    estimate = observing(vehicle, 4.0, effects=(DRAG[0],), drive="estimate")
    assert estimate.observes
    assert estimate.size == whole.size
    drive = reference_drive(reference, half_steps(begin * h, end - begin, h))
    fed = np.concatenate([drive, fine[:, :12]], axis=1)

    def observed(fed):
        states = roll(estimate, x0=fine[0][:, None], drive=fed, step_s=h, rows=estimate.size)
        return states[:, estimate.observer, 0]

    again = observed(fed)
    np.testing.assert_allclose(again[:, :3], fine[::2, whole.observer][:, :3], atol=1e-3)
    np.testing.assert_allclose(again[:, 3], fine[::2, whole.observer][:, 3], atol=1e-3)
    assert np.ptp(again[:, 0]) > 0.3
    # It observes with the attitude that is fed: nose up by 0.02 rad more, thrust ought to pull south.
    pitched = fed.copy()
    pitched[:, ESTIMATED_THETA.start + 1] += 0.02
    expected = 9.81 * 0.02 * (1.0 - np.exp(-4.0 * 0.1))
    assert (observed(pitched) - again)[20, 0] == pytest.approx(expected, rel=0.3)


def test_phi_inputs_and_estimate_drives_retrace_a_reference_driven_flight(vehicle, make_reference):
    """Recorded inputs or estimates of a flight give the flight back: thrusts and states of the same model."""
    reference = make_reference(duration_s=3.0)
    h, steps = 0.005, 600
    whole = Phi(vehicle=vehicle, effects=(DRAG[0],), estimator=False)
    times = half_steps(0.0, steps, h)
    start = flat_outputs(reference, np.zeros(1))[:, 0]
    roll = partial(roll_out, flight=flight_constants(), theta=np.array(DRAG[1]))
    drive = reference_drive(reference, half_steps(0.0, 2 * steps, 0.5 * h))
    fine = roll(
        whole, x0=whole.hover(start[:3].tolist(), 0.0)[:, None], drive=drive, step_s=0.5 * h, rows=whole.size
    )[:, :, 0]
    assert fine.shape[0] == times.size

    estimate = Phi(vehicle=vehicle, effects=(DRAG[0],), drive="estimate")
    fed = np.concatenate([reference_drive(reference, times), fine[:, :12]], axis=1)
    again = roll(estimate, x0=fine[0][:19, None], drive=fed, step_s=h)[:, :, 0]
    np.testing.assert_allclose(again[:, :3], fine[::2, :3], atol=1e-5)

    inputs = Phi(vehicle=vehicle, effects=(DRAG[0],), drive="inputs")
    lag = vehicle.motor_lag_s + inputs.hold_s
    thrust = fine[:, 12:16]
    commanded = thrust + lag * np.gradient(thrust, 0.5 * h, axis=0, edge_order=2)
    recorded = np.concatenate([commanded, np.ones((times.size, 1)), times[:, None]], axis=1)
    again = roll(inputs, x0=fine[0][:16, None], drive=recorded, step_s=h)[:, :, 0]
    np.testing.assert_allclose(again[:200, :3], fine[:400:2, :3], atol=1e-3)


def test_phi_network_adds_its_acceleration(vehicle, make_reference):
    """A network with only an output bias is a constant acceleration; in NED like a wind on drag."""
    reference = make_reference(duration_s=3.0)
    layout = Layout(hidden=(3,))
    xi = np.zeros(layout.size)
    xi[layout.size - 3 * 4 + 3 :: 4] = (0.3, -0.2, 0.1)
    phi = Phi(vehicle=vehicle, estimator=False)
    pushed = predict(phi, reference, network=Network(layout=layout, xi=xi))
    offset = (pushed - predict(phi, reference))[-1, :3]
    stiffness = np.array(vehicle.gains.position_p)
    np.testing.assert_allclose(offset, np.array([0.3, -0.2, 0.1]) / stiffness, rtol=0.15)


def test_roll_out_lanes_are_independent_even_beside_one_that_diverges(vehicle, make_reference):
    reference = make_reference(duration_s=2.0)
    phi = Phi(vehicle=vehicle, effects=(DRAG[0],), estimator=False)
    drive = reference_drive(reference, half_steps(0.0, 100, 0.02))
    start = flat_outputs(reference, np.zeros(1))[:, 0]
    x0 = np.repeat(phi.hover(start[:3].tolist(), 0.0)[:, None], 3, axis=1)
    theta = np.array([[0.4, -1e6, 0.1]] * 3 + [[0.0] * 3] * 2)
    together = roll_out(phi, x0=x0, drive=drive, flight=flight_constants(), theta=theta, step_s=0.02)
    alone = roll_out(
        phi, x0=x0[:, 2:], drive=drive, flight=flight_constants(), theta=theta[:, 2], step_s=0.02
    )
    np.testing.assert_array_equal(together[:, :, 2], alone[:, :, 0])
    assert not np.isfinite(together[-1, :, 1]).all()


def test_roll_out_several_flights_gather_their_own_drive(vehicle, make_reference):
    references = [make_reference(duration_s=2.0, size=size) for size in (1.0, 0.5)]
    phi = Phi(vehicle=vehicle, effects=(DRAG[0],), estimator=False)
    drives = [reference_drive(r, half_steps(0.0, 100, 0.02)) for r in references]
    x0 = np.repeat(phi.hover(references[0].nodes_ned()[0].state[:3], 0.0)[:, None], 4, axis=1)
    theta = np.array([[0.0, 0.4, 0.0, 0.4]] * 3 + [[0.0] * 4] * 2)
    lanes = roll_out(
        phi,
        x0=x0,
        drive=np.stack(drives, axis=2),
        flight=np.stack([flight_constants()] * 2, axis=1),
        theta=theta,
        step_s=0.02,
        lane_flight=np.array([0, 0, 1, 1]),
    )
    for lane, flight in enumerate((0, 0, 1, 1)):
        alone = roll_out(
            phi,
            x0=x0[:, :1],
            drive=drives[flight],
            flight=flight_constants(),
            theta=theta[:, lane],
            step_s=0.02,
        )
        np.testing.assert_array_equal(lanes[:, :, lane], alone[:, :, 0])


def test_phi_wrong_arguments_are_refused(vehicle):
    phi = Phi(vehicle=vehicle, estimator=False)
    with pytest.raises(ValueError, match="drive must be one of"):
        Phi(vehicle=vehicle, drive="thrust")  # pyright: ignore[reportArgumentType]  # there is no such drive
    with pytest.raises(ValueError, match="hold_s"):
        Phi(vehicle=vehicle, hold_s=-1.0)
    with pytest.raises(ValueError, match="has no linear-drag"):
        phi.theta([DRAG])
    drive = np.zeros((4, DRIVE_ROWS["reference"]))
    flight, theta = flight_constants(), phi.theta_neutral
    with pytest.raises(ValueError, match="odd number of rows"):
        roll_out(phi, x0=np.zeros((19, 1)), drive=drive, flight=flight, theta=theta, step_s=0.01)
    with pytest.raises(ValueError, match="x0 must have 19 rows"):
        roll_out(phi, x0=np.zeros((16, 1)), drive=drive[:3], flight=flight, theta=theta, step_s=0.01)


@pytest.mark.parametrize(("delay_ms", "bound_m"), [(10, 0.5e-3), (20, 1.5e-3)])
def test_phi_feedback_delay_equals_a_loop_fed_from_its_history(vehicle, make_reference, delay_ms, bound_m):
    """The delayed system itself, position and velocity out of a history, at 1 ms."""
    reference = make_reference(duration_s=4.0)
    fed = Phi(vehicle=vehicle, drive="estimate")
    bound = Batch(fed.function, 1)
    bound.inputs["flight"][:, 0] = flight_constants()
    x = fed.hover(reference.nodes_ned()[0].state[:3], 0.0)
    steps = 4000
    drive = reference_drive(reference, half_steps(0.0, steps, 1e-3))
    past = [x[:6].copy() for _ in range(delay_ms + 1)]
    exact = [x[:12].copy()]

    def rate(state, k, seen):
        bound.inputs["x"][:, 0] = state
        bound.inputs["drive"][:, 0] = [*drive[k], *seen, *state[6:12]]
        bound()
        return bound.outputs["xdot"][:, 0].copy()

    for k in range(steps):
        begin, end = past[0], past[1]
        middle = 0.5 * (begin + end)
        k1 = rate(x, 2 * k, begin)
        k2 = rate(x + 0.5e-3 * k1, 2 * k + 1, middle)
        k3 = rate(x + 0.5e-3 * k2, 2 * k + 1, middle)
        k4 = rate(x + 1e-3 * k3, 2 * k + 2, end)
        x = x + 1e-3 / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        past = [*past[1:], x[:6].copy()]
        if (k + 1) % 20 == 0:
            exact.append(x[:12].copy())
    phi = Phi(vehicle=vehicle, estimator=False)
    delayed = predict(phi, reference, step_s=0.02, feedback_delay_s=delay_ms * 1e-3)
    ignored = predict(phi, reference, step_s=0.02)
    assert rmse(delayed, np.array(exact)) < bound_m
    assert rmse(ignored, np.array(exact)) > 5.0 * rmse(delayed, np.array(exact))


def test_feedforward_rows_of_a_network_are_its_output_at_the_flat_attitude(vehicle, make_reference):
    reference = make_reference(turning=True)
    layout = Layout(hidden=(4,))
    xi = layout.initial(np.random.default_rng(2)) * 5.0
    fed = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, layers=(4,), weights=tuple(xi))
    times = np.linspace(0.5, 5.0, 20)
    flat = flat_outputs(reference, times)
    rows = feedforward_rows(flat, fed)
    f = np.array([[0.0], [0.0], [9.81]]) - flat[6:9]
    yaw = flat[12]
    forward = f[0] * np.cos(yaw) + f[1] * np.sin(yaw)
    side = f[1] * np.cos(yaw) - f[0] * np.sin(yaw)
    pitch = np.arctan2(forward, f[2])
    roll = -np.arcsin(side / np.linalg.norm(f, axis=0))
    weights = np.array(fed.weights)
    expected = layout.arrays(weights, np.concatenate([flat[3:6], [roll], [pitch], [yaw]]))
    np.testing.assert_allclose(rows[:3], expected, atol=1e-9)
    assert not feedforward_rows(flat, replace(fed, version=1))[3:].any()
    h = 1e-5
    ahead, behind = (feedforward_rows(flat_outputs(reference, times + dt), fed) for dt in (h, -h))
    np.testing.assert_allclose(rows[3:], (ahead[:3] - behind[:3]) / (2.0 * h), atol=1e-4)
