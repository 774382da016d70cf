"""The simulated body: invariants of its physics, agreement with the nominal vehicle, repeatability."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.sitl.draw import World, draw_world
from trimtab.sitl.plant import Plant, pack, plant_engine
from trimtab.sitl.plant_constants import plant_parameters
from trimtab.sitl.plant_model import PARAMETERS, PARTS, Block
from trimtab.sitl.surroundings import GRAVITY_M_S2
from trimtab.sitl.vectors import rotation
from trimtab.sitl.world import WorldFile, load_world

ACCELERATION, TURNING = slice(24, 27), slice(27, 30)
PAYLOAD, CLOCK = slice(30, 36), slice(38, 41)
LEVEL = (1.0, 0.0, 0.0, 0.0)
STATE_P, STATE_V, STATE_Q, STATE_RATE, STATE_SPEED = (
    slice(0, 3),
    slice(3, 6),
    slice(6, 10),
    slice(10, 13),
    slice(13, 17),
)


@pytest.fixture(params=["research", "nano"])
def vehicle(request: pytest.FixtureRequest) -> Vehicle:
    return load_vehicle(request.param)


def shipped(name: str, vehicle: Vehicle, seed: int = 1) -> World:
    return draw_world(name, load_world(name)[1], seed, vehicle)


def stated(vehicle: Vehicle, effects: dict[str, dict[str, float]]) -> World:
    calm = {"force_m_s2": 0.0, "torque_rad_s2": 0.0}
    file = WorldFile.model_validate(
        {"description": "test", "tolerances": False, "effects": effects, "turbulence": calm}
    )
    return draw_world("test", file, 0, vehicle)


def drawn(vehicle: Vehicle, kinds: tuple[str, ...]) -> World:
    draw = {"count": (len(kinds), len(kinds)), "kinds": kinds}
    return draw_world(
        "test", WorldFile.model_validate({"description": "x", "tolerances": True, "draw": draw}), 2, vehicle
    )


def airborne(plant: Plant, **parts: Sequence[float]) -> None:
    """Puts parts of the state where they are wanted, ten metres up."""
    plant.reset((0.0, 0.0, -10.0), LEVEL)
    slices = {"v": STATE_V, "q": STATE_Q, "rate": STATE_RATE, "speed": STATE_SPEED}
    for name, values in parts.items():
        for index, value in zip(range(24)[slices[name]], values, strict=True):
            plant.state[index] = value


def hover_command(vehicle: Vehicle) -> float:
    share = vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n)
    c1, c2 = vehicle.thrust_curve
    return 2.0 * share / (c1 + math.sqrt(c1 * c1 + 4.0 * c2 * share))


def test_body_tumbling_without_rotors_keeps_momentum_and_energy(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, stated(vehicle, {"com-offset": {"x": 0.006, "y": -0.003}}), 0)
    airborne(plant, rate=(3.0, -2.0, 5.0), v=(1.0, 2.0, -3.0))
    J = plant_parameters(vehicle, stated(vehicle, {"com-offset": {"x": 0.006, "y": -0.003}}))["inertia"]
    tensor = np.array([[J[0], J[3], 0.0], [J[3], J[1], 0.0], [0.0, 0.0, J[2]]])

    def momentum_and_energy() -> tuple[np.ndarray, float, float]:
        state = np.array(plant.state)
        R = np.reshape(rotation(state[STATE_Q].tolist()), (3, 3))
        rate, v = state[STATE_RATE], state[STATE_V]
        fall = 0.5 * float(v @ v) - GRAVITY_M_S2 * float(state[2])
        return R @ tensor @ rate, 0.5 * float(rate @ tensor @ rate), fall

    plant.state[26] = GRAVITY_M_S2  # it has been falling
    before = momentum_and_energy()
    for _ in range(1000):
        plant.step((0.0, 0.0, 0.0, 0.0))
    after = momentum_and_energy()
    assert after[0] == pytest.approx(before[0], rel=1e-4, abs=1e-6 * float(np.linalg.norm(before[0])))
    assert after[1] == pytest.approx(before[1], rel=1e-4)
    assert after[2] == pytest.approx(before[2], rel=1e-9)


def test_quaternion_stays_of_unit_length(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, stated(vehicle, {}), 0)
    airborne(plant, rate=(8.0, -6.0, 4.0))
    for _ in range(500):
        plant.step((0.4, 0.2, 0.3, 0.5))
        assert math.fsum(c * c for c in plant.pose[6:10]) == pytest.approx(1.0, abs=1e-14)


def test_turned_start_flies_the_turned_path(vehicle: Vehicle) -> None:
    """Nothing in still air knows north: a start turned about the vertical turns everything after it."""
    turn = 0.7
    effects = {"linear-drag": {"dx": 0.5, "dy": 0.3, "dz": 0.1}, "quadratic-drag": {"c": 0.03}}
    ends = []
    for angle in (0.0, turn):
        plant = Plant(vehicle, stated(vehicle, effects), 0)
        v = (2.0 * math.cos(angle), 2.0 * math.sin(angle), -0.5)
        airborne(plant, v=v, q=(math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)), rate=(0.5, 0.2, -0.3))
        u = hover_command(vehicle)
        for _ in range(400):
            plant.step((u * 1.02, u, u, u * 0.99))
        ends.append(np.array(plant.pose[0:3]))
    c, s = math.cos(turn), math.sin(turn)
    expected = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ ends[0]
    assert ends[1] == pytest.approx(expected, abs=1e-9)


def test_vehicle_on_floor_rests_and_measures_gravity(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, shipped("empty", vehicle), 0)
    plant.reset((1.0, -2.0, 0.0), LEVEL)
    for _ in range(2000):
        plant.step((0.0, 0.0, 0.0, 0.0))
    assert plant.pose[0:3].tolist() == pytest.approx([1.0, -2.0, 0.0], abs=2e-3)
    assert plant.sensed[3:6].tolist() == pytest.approx([0.0, 0.0, -GRAVITY_M_S2], abs=0.05)
    assert max(map(abs, plant.sensed[0:3])) < 0.02


def test_vehicle_dropped_on_floor_comes_to_rest(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, stated(vehicle, {}), 0)
    plant.reset((0.0, 0.0, -0.2), LEVEL)
    airborne_tilt = (math.cos(0.05), math.sin(0.05), 0.0, 0.0)
    for index, value in zip(range(6, 10), airborne_tilt, strict=True):
        plant.state[index] = value
    plant.state[3] = 0.3
    for _ in range(3000):
        plant.step((0.0, 0.0, 0.0, 0.0))
    assert max(map(abs, plant.pose[3:6])) < 1e-2
    assert abs(plant.pose[2]) < 2e-3


def test_quiet_world_hovers_on_the_vehicle_files_hover_command(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, shipped("quiet", vehicle), 0)
    share = math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n))
    airborne(plant, speed=(share,) * 4)
    u = hover_command(vehicle)
    for _ in range(1000):
        plant.step((u, u, u, u))
    assert plant.pose[0:3].tolist() == pytest.approx([0.0, 0.0, -10.0], abs=1e-6)
    assert plant.sensed[6] == vehicle.battery.full_v


def test_discharging_battery_moves_the_voltage_and_not_the_thrust(vehicle: Vehicle) -> None:
    ends = []
    for discharges in (False, True):
        content = {"description": "x", "tolerances": False, "battery": {"discharges": discharges}}
        content["turbulence"] = {"force_m_s2": 0.0, "torque_rad_s2": 0.0}
        plant = Plant(vehicle, draw_world("x", WorldFile.model_validate(content), 0, vehicle), 1)
        airborne(plant, speed=(0.5,) * 4)
        for _ in range(2000):
            plant.step((0.5, 0.52, 0.5, 0.48))
        ends.append((plant.sensed[6], plant.state[:17].tolist()))
    (constant, still), (moved, discharged) = ends
    assert constant == vehicle.battery.full_v
    assert moved < 0.98 * constant
    assert discharged == pytest.approx(still, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("step", [0.02, -0.02, 0.15, -0.15])
def test_thrust_after_a_step_lags_as_the_vehicle_file_says(vehicle: Vehicle, step: float) -> None:
    """First-order rotor speed is not first-order thrust, but near enough the same time constant."""
    plant = Plant(vehicle, shipped("quiet", vehicle), 0)
    share = math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n))
    airborne(plant, speed=(share,) * 4)
    u = hover_command(vehicle) * (1.0 + step)
    thrust = []
    for _ in range(400):
        plant.step((u, u, u, u))
        thrust.append(plant.state[13] ** 2)
    first, last = share**2, thrust[-1]
    rise = [0.5, *((last - t) / (last - first) for t in thrust)]
    missing = sum(rise) * 1e-3  # the area above a first-order rise is its lag
    tolerance = vehicle.tolerance("motor-lag", "extra_s", 0.001)
    size = abs(step) / 0.15
    assert missing == pytest.approx(vehicle.motor_lag_s, abs=max(0.1 * tolerance, 2.0 * size * tolerance))


def test_plant_with_the_same_seed_repeats_its_states_to_the_bit(vehicle: Vehicle) -> None:
    ends = []
    for flight in (3, 3, 4):
        plant = Plant(vehicle, shipped("draughty", vehicle, seed=9), flight)
        plant.reset((0.0, 0.0, -2.0), LEVEL)
        for k in range(1500):
            plant.step((0.4, 0.41, 0.42, 0.4 + 0.01 * (k % 3)))
        ends.append(bytes(plant.state))
    assert ends[0] == ends[1]
    assert ends[0] != ends[2]


@pytest.mark.parametrize("kinds", [("battery-sag", "motor-lag", "rotor-loss"), tuple(sorted(PARTS))])
def test_plant_compiled_or_not_gives_the_same_bits(
    vehicle: Vehicle,
    kinds: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    require: Callable[[str], None],
) -> None:
    require("compiler")
    world = drawn(vehicle, kinds)
    ends = []
    for engine in ("vm", "c"):
        monkeypatch.setenv("TRIMTAB_ENGINE", engine)
        plant = Plant(vehicle, world, 0)
        plant.reset((0.0, 0.0, 0.0), LEVEL)
        for k in range(2000):
            plant.step((0.5, 0.5, 0.52, 0.48 + 0.02 * (k % 2)))
        ends.append(bytes(plant.state))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("kind", sorted(PARTS - {"battery-sag"}))
def test_part_at_its_neutral_changes_nothing(vehicle: Vehicle, kind: str) -> None:
    """The tick with a part that does nothing, and without it: the same states to rounding."""
    ends = []
    for parts in (frozenset({kind}), frozenset[str]()):
        engine = plant_engine(parts)
        plant = Plant(vehicle, stated(vehicle, {}), 0)
        plant.reset((0.0, 0.0, -2.0), LEVEL)
        inputs: Any = engine.inputs
        inputs["parameters"][:] = pack(PARAMETERS, plant_parameters(vehicle, stated(vehicle, {})))
        inputs["state"][:] = plant.state
        for k in range(300):
            command = (0.5, 0.5, 0.52, 0.48 + 0.001 * k)
            inputs["commands"][:] = pack((Block("commands", 8),), {"commands": 2 * command})
            engine.run()
            inputs["state"][:] = engine.outputs["state"]
        ends.append(np.array(engine.outputs["state"])[:18])
    assert ends[0] == pytest.approx(ends[1], rel=1e-9, abs=1e-12)


def test_payload_lies_slack_on_the_floor_and_weighs_in_the_air(vehicle: Vehicle) -> None:
    world = stated(vehicle, {"slung-payload": {"ratio": 0.1, "length_m": 0.5, "damping": 0.04}})
    plant = Plant(vehicle, world, 0)
    plant.reset((0.0, 0.0, 0.0), LEVEL)
    for _ in range(1000):
        plant.step((0.0, 0.0, 0.0, 0.0))
    assert plant.pose[0:3].tolist() == pytest.approx([0.0, 0.0, 0.0], abs=6e-4)
    assert plant.state[PAYLOAD][2] == pytest.approx(0.003, abs=1e-3)

    plant.reset((0.0, 0.0, -10.0), LEVEL)
    share = math.sqrt(1.1 * vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n))
    for index in range(24)[STATE_SPEED]:
        plant.state[index] = share
    c1, c2 = vehicle.thrust_curve
    u = 2.0 * share * share / (c1 + math.sqrt(c1 * c1 + 4.0 * c2 * share * share))
    for _ in range(1500):
        plant.step((u, u, u, u))
    assert plant.pose[0:3].tolist() == pytest.approx([0.0, 0.0, -10.0], abs=5e-3)
    assert plant.state[PAYLOAD][2] - plant.pose[2] == pytest.approx(0.506, abs=1e-3)


def test_load_hangs_in_its_clamp_until_its_time_after_lift_off(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, stated(vehicle, {"dropped-load": {"share": 0.1, "at_s": 0.5}}), 0)
    plant.reset((0.0, 0.0, 0.0), LEVEL)
    for _ in range(1000):  # on the floor, no time passes
        plant.step((0.0, 0.0, 0.0, 0.0))
    assert plant.state[CLOCK][0] == 0.0
    share = math.sqrt(1.1 * vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n))
    airborne(plant, speed=(share,) * 4)
    c1, c2 = vehicle.thrust_curve
    u = 2.0 * share * share / (c1 + math.sqrt(c1 * c1 + 4.0 * c2 * share * share))
    climbs = []
    for _ in range(600):
        before = plant.pose[5]
        plant.step((u, u, u, u))
        climbs.append((before - plant.pose[5]) / 1e-3)
    assert climbs[:499] == pytest.approx([0.0] * 499, abs=1e-6)
    assert climbs[501:] == pytest.approx([0.1 * GRAVITY_M_S2] * 99, rel=1e-3)


def test_camera_in_its_gimbal_pitches_a_tilted_vehicle(vehicle: Vehicle) -> None:
    """The camera hangs back of a vehicle with its nose up: thrust, ahead of it, lifts the nose further."""
    plant = Plant(vehicle, stated(vehicle, {"stabilised-camera": {"lever_m": 0.01}}), 0)
    share = math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n))
    u = hover_command(vehicle)
    for pitch in (0.0, 0.2, -0.2):
        airborne(plant, speed=(share,) * 4, q=(math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0))
        for _ in range(2):  # the first tick goes ahead with the accelerations of the tick before
            plant.step((u, u, u, u))
        turning = vehicle.mass_kg * GRAVITY_M_S2 * 0.01 * math.sin(pitch) / vehicle.inertia_kg_m2[1]
        assert plant.state[TURNING][1] == pytest.approx(turning, rel=0.02, abs=1e-9)


def test_stuttering_motor_loses_speed_at_its_times(vehicle: Vehicle) -> None:
    times = {"every_s": 1.0, "length_s": 0.08}
    towards = math.atan2(vehicle.rotors[2].position_m[1], vehicle.rotors[2].position_m[0])
    kind = {"stuttering-motor": {"depth": 0.5, "towards": towards, **times}}
    plant = Plant(vehicle, stated(vehicle, kind), 0)
    plant.reset((0.0, 0.0, -100.0), LEVEL)
    u, slow = hover_command(vehicle), 0
    for _ in range(2000):
        plant.step((u, u, u, u))
        speeds = plant.state[STATE_SPEED].tolist()
        assert speeds[0] == speeds[1] == speeds[3]
        slow += speeds[2] < 0.99 * speeds[0]
    assert 160 < slow < 1000


def test_sweeping_fan_pushes_once_a_period_and_each_flight_at_its_own_time(vehicle: Vehicle) -> None:
    kind = {"sweeping-fan": {"push_m_s2": 1.0, "period_s": 4.0, "towards": 0.0}}
    greatest = []
    for flight in range(3):
        plant = Plant(vehicle, stated(vehicle, kind), flight)
        plant.reset((0.0, 0.0, -100.0), LEVEL)
        pushes = []
        for _ in range(4000):
            plant.step((0.0, 0.0, 0.0, 0.0))
            pushes.append(plant.state[ACCELERATION][0])
        assert max(pushes) == pytest.approx(1.0, abs=0.25)  # the vehicle already moves with the air
        assert sum(push > 0.5 * max(pushes) for push in pushes) == pytest.approx(525, abs=60)
        greatest.append(pushes.index(max(pushes)))
    assert len(set(greatest)) == 3


def test_command_arrives_late_by_the_delay_of_the_world(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, stated(vehicle, {"actuation-delay": {"delay_s": 0.01}}), 0)
    plant.reset((0.0, 0.0, -2.0), LEVEL)
    first = [0, 0, 0, 0]
    for k in range(20):
        plant.step((0.5, 0.5, 0.5, 0.5))
        for i, speed in enumerate(plant.state[STATE_SPEED]):
            first[i] = first[i] or (k if speed > 0.0 else 0)
    assert first == [10, 9, 9, 10]  # 10.5, 9.7, 9.5 and 10.3 ticks


def test_heavier_vehicle_hovers_with_more_thrust(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, stated(vehicle, {"mass": {"factor": 1.2}}), 0)
    airborne(
        plant, speed=(math.sqrt(1.2 * vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n)),) * 4
    )
    plant.step((0.0, 0.0, 0.0, 0.0))
    assert plant.sensed[5] == pytest.approx(-GRAVITY_M_S2, rel=0.03)


def test_battery_in_a_sagging_world_starts_elsewhere_every_flight_and_falls(vehicle: Vehicle) -> None:
    starts = set()
    for flight in range(3):
        plant = Plant(vehicle, shipped("worn", vehicle), flight)
        plant.reset((0.0, 0.0, -2.0), LEVEL)
        volts = []
        for _ in range(2000):
            plant.step((0.5, 0.5, 0.5, 0.5))
            volts.append(plant.sensed[6])
        assert volts[-1] < volts[0] <= vehicle.battery.full_v
        assert volts[-1] > vehicle.battery.empty_v
        starts.add(volts[0])
    assert len(starts) == 3


def test_turbulence_has_the_worlds_strength(vehicle: Vehicle) -> None:
    plant = Plant(vehicle, shipped("empty", vehicle), 0)
    plant.reset((0.0, 0.0, 0.0), LEVEL)
    gusts = []
    for _ in range(40_000):
        plant.step((0.0, 0.0, 0.0, 0.0))
        gusts.append(plant.state[18:24].tolist())
    deviation = np.std(gusts, axis=0)
    assert deviation[:3] == pytest.approx(0.04, rel=0.35)  # 40 s hold about 130 correlation times
    assert deviation[3:] == pytest.approx(0.5, rel=0.35)
