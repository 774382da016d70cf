"""Roll-outs of segments: against closed forms, and their Jacobian against larger central differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.effects import load_effects
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.parameters import space
from trimtab.host.trace.segment_fit import linearise, model, rollout
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.vehicle import load_vehicle

VEHICLE = load_vehicle("research")
SPACE = space(VEHICLE, load_effects())
STEPS, PRE, DT = 60, 17, 0.01
FORM = SegmentModel(VEHICLE, SPACE, dt_s=DT, in_newton=False, rate_driven=False)
HOVER = np.sqrt(VEHICLE.mass_kg * GRAVITY / 4.0 / VEHICLE.thrust_max_n)


def make(command: np.ndarray, x0: np.ndarray) -> Segments:
    count = len(x0)
    n = (count, STEPS)
    return Segments(
        dt_s=DT,
        flight=np.zeros(count, dtype=int),
        start_s=np.zeros(count),
        x0=x0,
        p_ned=np.zeros((*n, 3)),
        R_ned_frd=np.tile(np.eye(3).ravel(), (*n, 1)),
        shift_s=np.zeros(n),
        pose_weight=np.ones(n),
        rate_frd=np.zeros((*n, 3)),
        rate_weight=np.ones(n),
        force_frd=np.zeros((*n, 3)),
        force_weight=np.ones(n),
        command=command,
        voltage_ratio=np.ones(n),
        sigma=np.ones((count, 4)),
        disturbance_frd=np.zeros((count, 6, 6)),
        path_start_s=np.zeros(count),
        paths=x0[:1, None].repeat(2, axis=1),
        in_newton=False,
        rate_driven=False,
    )


def lanes(data: Segments, theta_scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return data.x0.T[:, None, :], theta_scaled[:, None], np.zeros((model.NUISANCES, 1, len(data.flight)))


def test_roll_out_of_hover_at_a_velocity_moves_straight_on() -> None:
    x0 = np.zeros((1, 12))
    x0[0, 0:6] = [1.0, 2.0, -3.0, 0.5, -0.25, 0.1]
    data = make(np.full((1, PRE + STEPS, 4), HOVER), x0)
    predicted = rollout.roll_out(FORM, data, *lanes(data, np.zeros(len(SPACE.columns))))[:, :, 0, 0]
    t = DT * np.arange(STEPS)
    expected = x0[0, :3, None] + x0[0, 3:6, None] * t
    np.testing.assert_allclose(predicted[:, :3].T, expected, atol=1e-9)
    np.testing.assert_allclose(predicted[:, 3:9], 0.0, atol=1e-12)
    np.testing.assert_allclose(predicted[:, 9:], np.tile([0.0, 0.0, -GRAVITY], (STEPS, 1)), atol=1e-9)


def test_roll_out_with_linear_drag_decays_exponentially() -> None:
    x0 = np.zeros((1, 12))
    x0[0, 3] = 2.0
    data = make(np.full((1, PRE + STEPS, 4), HOVER), x0)
    theta_scaled = np.zeros(len(SPACE.columns))
    theta_scaled[SPACE.groups["linear-drag"][0]] = 1.0
    d = SPACE.values(theta_scaled)[SPACE.groups["linear-drag"][0]]
    position = rollout.roll_out(FORM, data, *lanes(data, theta_scaled))
    t = DT * np.arange(STEPS)
    np.testing.assert_allclose(position[:, 0, 0, 0], 2.0 / d * (1.0 - np.exp(-d * t)), atol=5e-6)


def test_roll_out_responds_to_a_thrust_step_with_the_motor_lag() -> None:
    command = np.full((1, PRE + STEPS, 4), HOVER)
    command[:, PRE:] = np.sqrt(1.2) * HOVER
    data = make(command, np.zeros((1, 12)))
    force = rollout.roll_out(FORM, data, *lanes(data, np.zeros(len(SPACE.columns))))[:, 9:]
    t = DT * (np.arange(STEPS) + 0.5)
    expected = -GRAVITY * (1.0 + 0.2 * (1.0 - np.exp(-t / VEHICLE.motor_lag_s)))
    np.testing.assert_allclose(force[:, 2, 0, 0], expected, atol=1e-9)


def test_roll_out_and_remembered_states_in_c_equal_those_of_casadi(
    monkeypatch: pytest.MonkeyPatch, require: Callable[[str], None]
) -> None:
    require("compiler")
    rng = np.random.default_rng(6)
    count, segments = 11, 3
    x0 = 0.2 * rng.normal(size=(segments, 12))
    data = make(HOVER * (1.0 + 0.1 * rng.normal(size=(segments, PRE + STEPS, 4))), x0)
    data = replace(
        data,
        flight=np.array([0, 0, 1]),
        paths=0.3 * rng.normal(size=(2, 40, 12)),
        path_start_s=np.array([0.0, 0.31, 0.05]),
        R_ned_frd=Rotation.from_rotvec(0.2 * rng.normal(size=(segments * STEPS, 3)))
        .as_matrix()
        .reshape(segments, STEPS, 9),
        shift_s=2e-3 * rng.normal(size=(segments, STEPS)),
        disturbance_frd=0.1 * rng.normal(size=(segments, 6, 6)),
        start_s=np.arange(3.0),
    )
    theta_scaled = 0.3 * rng.normal(size=(len(SPACE.columns), count))
    theta_scaled[SPACE.groups["actuation-delay"][0]] = np.linspace(0.0, 2.5, count)
    nuisances = 1e-2 * rng.normal(size=(model.NUISANCES, count, segments))
    bins = 0.1 * rng.normal(size=(6, 6, count))
    results = []
    for engine in ("c", "vm"):
        monkeypatch.setenv("TRIMTAB_ENGINE", engine)
        form = SegmentModel(VEHICLE, SPACE, dt_s=DT, in_newton=False, rate_driven=False)
        lane = (np.repeat(x0.T[:, None], count, axis=1), theta_scaled, nuisances)
        results.append(
            (rollout.remembered(form, data, theta_scaled), rollout.roll_out(form, data, *lane, bins))
        )
    for ours, theirs in zip(*results, strict=True):
        assert np.abs(theirs).max() > 0.1
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


def test_columns_of_small_steps_equal_central_differences() -> None:
    rng = np.random.default_rng(3)
    x0 = 0.2 * rng.normal(size=(2, 12))
    command = HOVER * (1.0 + 0.02 * rng.normal(size=(2, PRE + STEPS, 4)))
    data = make(command, x0)
    theta_scaled = 0.1 * rng.normal(size=len(SPACE.columns))
    nuisances = np.zeros((1, model.NUISANCES))
    columns, _ = linearise.basis(FORM, data, theta_scaled, nuisances).columns(FORM, data, np.arange(2), 0)

    def residual(x0: np.ndarray, w: np.ndarray) -> np.ndarray:
        at = replace(data, x0=x0, disturbance_frd=w)
        lane = (at.x0.T[:, None, :], theta_scaled[:, None], np.zeros((model.NUISANCES, 1, 2)))
        return rollout.residuals(at, rollout.roll_out(FORM, at, *lane))[0]

    h = 1e-4
    for column in (0, 4, 7, 10):
        up, down = x0.copy(), x0.copy()
        up[:, column] += h
        down[:, column] -= h
        slope = (residual(down, data.disturbance_frd) - residual(up, data.disturbance_frd)) / (2 * h)
        np.testing.assert_allclose(columns[:, column], slope, atol=2e-4 * max(1.0, np.abs(slope).max()))
    w = np.zeros((2, 6, 6))
    w[:, 2, 4] = h
    slope = (residual(x0, -w) - residual(x0, w)) / (2 * h)
    np.testing.assert_allclose(
        columns[:, model.STATES + model.NUISANCES + 6 * 2 + 4],
        slope,
        atol=2e-4 * max(1.0, np.abs(slope).max()),
    )


def test_fitted_x0_recovers_the_state_that_made_the_measurements() -> None:
    rng = np.random.default_rng(8)
    truth = 0.2 * rng.normal(size=(3, 12))
    data = make(np.full((3, PRE + STEPS, 4), HOVER), truth)
    theta_scaled, nuisances = np.zeros(len(SPACE.columns)), np.zeros((1, model.NUISANCES))
    attitude, predicted_poses = data.R_ned_frd, np.zeros((0, 0, 12))
    for _ in range(4):  # the predicted attitude is told as what the measured one must turn by
        rolled = rollout.roll_out(FORM, replace(data, R_ned_frd=attitude), *lanes(data, theta_scaled))
        predicted_poses = np.transpose(rolled[:, :, 0], (2, 0, 1))
        turn = Rotation.from_rotvec(predicted_poses[..., 3:6].reshape(-1, 3)).as_matrix()
        attitude = (attitude.reshape(-1, 3, 3) @ turn).reshape(attitude.shape)
    measured = replace(
        data,
        x0=truth + 0.02 * rng.normal(size=truth.shape),
        p_ned=predicted_poses[..., :3],
        R_ned_frd=attitude,
        rate_frd=predicted_poses[..., 6:9],
        force_frd=predicted_poses[..., 9:],
    )
    basis = linearise.basis(FORM, measured, theta_scaled, nuisances)
    x0 = linearise.fitted_x0(FORM, measured, theta_scaled, nuisances, basis, iterations=5)
    np.testing.assert_allclose(x0, truth, atol=1e-6)


def test_linearisation_depends_neither_on_threads_nor_on_stored_columns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(4)
    x0 = 0.2 * rng.normal(size=(5, 12))
    data = replace(
        make(np.full((5, PRE + STEPS, 4), HOVER), x0),
        flight=np.array([0, 0, 0, 1, 1]),
        paths=x0[[0, 3], None].repeat(2, axis=1),
    )
    theta_scaled, nuisances = 0.1 * rng.normal(size=len(SPACE.columns)), np.zeros((2, model.NUISANCES))

    def linearised(jobs: int, stored: int) -> tuple[np.ndarray, ...]:
        monkeypatch.setattr(linearise, "_STORED", stored)
        form = SegmentModel(VEHICLE, SPACE, dt_s=DT, in_newton=False, rate_driven=False, jobs=jobs)
        basis = linearise.basis(form, data, theta_scaled, nuisances)
        linearise.linearise(form, data, theta_scaled, nuisances, basis)
        lin, x = linearise.linearise(form, data, theta_scaled, nuisances, basis)
        return lin.own, lin.square, lin.cross, x

    expected = linearised(1, 400)
    for jobs, stored in ((3, 400), (1, 0)):
        for ours, theirs in zip(linearised(jobs, stored), expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("present", [(), ("linear-drag", "thrust-gain")], ids=["none", "two"])
def test_segments_have_no_slopes_of_forms_whose_effect_is_absent(present: tuple[str, ...]) -> None:
    rng = np.random.default_rng(4)
    x0 = rng.normal(size=(2, 12)) * np.repeat([0.2, 2.0, 0.2, 0.2], 3)
    data = make(1.1 * HOVER * (1.0 + 0.05 * rng.normal(size=(2, PRE + STEPS, 4))), x0)
    data = replace(data, force_weight=np.zeros((2, STEPS)))  # hovering, it would be no zero force
    theta_scaled, nuisances = np.zeros(len(SPACE.columns)), np.zeros((1, model.NUISANCES))
    for name in present:
        theta_scaled[list(SPACE.groups[name])] = 1.0
    basis = linearise.basis(FORM, data, theta_scaled, nuisances)
    lin, _ = linearise.linearise(FORM, data, theta_scaled, nuisances, basis)
    sizes = np.einsum("sii->i", lin.own)[1:][: len(theta_scaled)]
    forms = {i for columns in SPACE.forms.values() for i in columns}
    assert set(np.flatnonzero(sizes)) & forms == {i for name in present for i in SPACE.forms[name]}
    assert (np.abs(lin.cross).max((0, 1))[1:][[*forms]][sizes[[*forms]] == 0.0] == 0.0).all()
    assert sizes[list(SPACE.groups["quadratic-drag"])] > 0.0


def lane_of(data: Segments, **values: float) -> np.ndarray:
    """Return the predicted measurements (H, 12) of the first segment with these parameters "effect__key"."""
    theta_scaled = np.zeros(len(SPACE.columns))
    for i, column in enumerate(SPACE.columns):
        name = f"{column.owner}__{column.key}".replace("-", "_")
        theta_scaled[i] = (values[name] - column.neutral) / column.scale if name in values else 0.0
    return rollout.roll_out(FORM, data, *lanes(data, theta_scaled))[:, :, 0, 0]


def test_delayed_commands_shift_the_response_to_a_step() -> None:
    command = np.full((1, PRE + STEPS, 4), HOVER)
    command[:, PRE + 10 :] = np.sqrt(1.2) * HOVER
    data = make(command, np.zeros((1, 12)))
    prompt, late = lane_of(data)[:, 11], lane_of(data, actuation_delay__delay_s=0.02)[:, 11]
    np.testing.assert_allclose(late[2:], prompt[:-2], atol=1e-9)
    half = lane_of(data, actuation_delay__delay_s=0.005)[:, 11]
    assert prompt[10] < half[10] < late[10]


def test_loss_of_one_rotor_rotates_about_all_axes() -> None:
    data = make(np.full((1, PRE + STEPS, 4), HOVER), np.zeros((1, 12)))
    rate = lane_of(data, rotor_loss__loss_2=0.1)[4, 6:9]
    rotor = VEHICLE.rotors[1]
    lost = -0.1 * VEHICLE.mass_kg * GRAVITY / 4.0
    torque = np.array([-rotor.position_m[1], rotor.position_m[0], VEHICLE.torque_per_thrust_m]) * lost
    np.testing.assert_allclose(rate, torque / np.array(VEHICLE.inertia_kg_m2) * 4.5 * DT, rtol=0.02)


def test_slung_payload_swings_with_its_period_from_rest() -> None:
    """On the measured path, the vehicle moves at first and stops at once."""
    above = np.zeros((1, 12))
    above[0, 2] = -2.0
    data = make(np.full((1, PRE + STEPS, 4), HOVER), above)
    paths = np.repeat(above[:, None], 11, axis=1)
    paths[0, 0, 3] = 0.3
    data = replace(data, paths=paths, path_start_s=np.array([0.2]))
    length = 0.6
    force = lane_of(data, slung_payload__ratio=1e-4, slung_payload__length_m=length)[:, 9]
    t = 0.2 - 0.01 + DT * (np.arange(STEPS) + 0.5)
    natural = np.sqrt(GRAVITY / length)
    fading = 0.3 * np.exp(-0.05 * natural * t)
    swing, speed = fading / natural * np.sin(natural * t), fading * np.cos(natural * t)
    np.testing.assert_allclose(force, 1e-4 * (natural**2 * swing + 2 * 0.05 * natural * speed), atol=5e-6)


def test_rotors_that_spin_up_turn_the_vehicle_against_their_angular_momentum() -> None:
    spins = np.array([rotor.spin_sign for rotor in VEHICLE.rotors])
    command = np.full((1, PRE + STEPS, 4), HOVER)
    command[:, PRE:] *= np.sqrt(1.0 + 0.1 * spins)
    data = make(command, np.zeros((1, 12)))
    spinning, without = (
        lane_of(data, gyroscopic__h=4.0, gyroscopic__spin_up=share)[:, 6:9] for share in (1.0, 0.0)
    )
    gained = 4.0 * VEHICLE.inertia_kg_m2[0] * (spins * np.sqrt(1.0 + 0.1 * spins)).sum()
    expected = [0.0, 0.0, gained / VEHICLE.inertia_kg_m2[2]]
    np.testing.assert_allclose((spinning - without)[-1], expected, rtol=2e-3, atol=1e-9)


def test_measured_turn_recovers_a_constant_torque_from_the_gyro() -> None:
    data = make(np.full((1, PRE + STEPS, 4), HOVER), np.zeros((1, 12)))
    ramp = 3.0 * DT * (np.arange(STEPS) + 0.5)
    rate = np.zeros((1, STEPS, 3))
    rate[0, :, 1] = ramp
    w = linearise.disturbance_from_measured_rotation(FORM, replace(data, rate_frd=rate))
    np.testing.assert_allclose(w[0, :, 4], 3.0, atol=1e-9)
    np.testing.assert_allclose(w[0, :, [0, 1, 2]], 0.0)


def test_measured_turn_without_a_gyro_recovers_the_torque_from_the_poses() -> None:
    data = make(np.full((1, PRE + STEPS, 4), HOVER), np.zeros((1, 12)))
    t = DT * np.arange(STEPS)
    turned = Rotation.from_euler("y", 0.5 * 3.0 * t[:, None] ** 2).as_matrix().reshape(1, STEPS, 9)
    pose_weight = np.ones((1, STEPS))
    pose_weight[0, 23:26] = 0.0
    turned[0, 23:26] = 0.0
    deaf = replace(data, R_ned_frd=turned, pose_weight=pose_weight, rate_weight=np.zeros((1, STEPS)))
    w = linearise.disturbance_from_measured_rotation(FORM, deaf)
    np.testing.assert_allclose(w[0, 1:5, 4], 3.0, atol=1e-6)
    np.testing.assert_allclose(w[0, [0, 5], 4], 3.0, atol=1.2)  # no pose lies beyond a segment's ends
    np.testing.assert_allclose(w[0, :, [0, 1, 2, 3, 5]], 0.0, atol=1e-9)


def test_segments_with_steps_that_do_not_fill_bins_raise() -> None:
    data = make(np.full((1, PRE + STEPS, 4), HOVER), np.zeros((1, 12)))
    with pytest.raises(ValueError, match="bins"):
        replace(data, dt_s=0.03)
