"""Plants of other simulators: their libraries' own numbers, our nominal vehicle, and every effect."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import trimtab
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.draw import World, draw_world
from trimtab.sitl.foreign import ForeignPlantError, load_foreign_plant
from trimtab.sitl.kinds import KINDS
from trimtab.sitl.plant import Plant
from trimtab.sitl.studies.blind import Task, fly, judge
from trimtab.sitl.studies.files import Ledger, read_json
from trimtab.sitl.studies.flights import Programme, plan_references
from trimtab.sitl.studies.plants import PLANTS
from trimtab.sitl.studies.worlds import PlannedWorld
from trimtab.sitl.world import Turbulence, load_world

NAMES = sorted(PLANTS)
VEHICLE = load_vehicle("research")
QUIET = draw_world("quiet", load_world("quiet")[1], 0, VEHICLE)
FULL_RAD_S = 1500.0
SENSED = {"mocap-latency", "frame-tilt"}
"""Effects on measurements, which are not a plant's."""


@pytest.fixture(autouse=True)
def _installed(require: Callable[[str], None]) -> None:
    require("plants")


def typical(*kinds: str) -> World:
    """The quiet world with these effects at their typical sizes; of rotors, the first one's."""
    effects: dict[str, dict[str, float]] = {}
    for name in kinds:
        kind = KINDS[name]
        values = {
            q.key: q.neutral + q.typical if q.drawn is None else float(np.mean(q.drawn))
            for q in kind.quantities
        }
        if kind.spread == "one":
            values |= {q.key: q.neutral for q in kind.quantities[1:]}
        effects[name] = values
    return dataclasses.replace(QUIET, effects=effects)


def make(name: str, world: World, seed: int = 1) -> Any:
    """The plant of this name, or ours."""
    return load_foreign_plant(PLANTS[name].spec, VEHICLE, {}, seed, world)


def flown(plant: Any, height_m: float, ticks: int = 700) -> np.ndarray:
    """Velocity and body rate (ticks, 6) in an open-loop motion that stirs all axes."""
    t = 1e-3 * np.arange(ticks)
    yaw, roll, pitch = 0.05 * np.sin(9 * t), 0.02 * np.sin(5 * t), 0.015 * np.cos(6 * t)
    hover = 0.466 * (1 + 0.1 * np.sin(8 * t))
    commands = np.stack([roll + yaw, yaw - roll, pitch - yaw, -pitch - yaw], axis=1) + 1.0
    plant.reset(
        (0.0, 0.0, -height_m), np.array([0.995, 0.06, 0.08, 0.0]) / np.linalg.norm([0.995, 0.06, 0.08])
    )
    rows = []
    for command in (commands * hover[:, None]).tolist():
        plant.step(command)
        rows.append([*plant.pose[3:6], *plant.sensed[0:3]])
    return np.array(rows)


def derivative(name: str, world: World, state: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The plant's derivative of p, v (NED), q (w first), rate (FRD) and rotor speeds (shares)."""
    simulation = importlib.import_module("trimtab.sitl.studies.plants.simulation")
    library = importlib.import_module(f"trimtab.sitl.studies.plants.{name}_plant")
    equations = library._Equations(simulation.craft(VEHICLE, world))
    x, u = ca.SX.sym("x", 17), ca.SX.sym("u", 4)
    body = {
        key: ca.vertsplit(x[a:b])
        for key, a, b in (
            ("p_ned", 0, 3),
            ("v_ned", 3, 6),
            ("q_ned_frd", 6, 10),
            ("rate_frd", 10, 13),
            ("speeds", 13, 17),
        )
    }
    slope = equations.derivative(body, ca.vertsplit(u), [0.0] * 3, [0.0] * 3, [0.0] * 3)
    return np.array(ca.Function("f", [x, u], [ca.vertcat(*slope)])(state, target)).ravel()


def random_state() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    q = rng.standard_normal(4)
    state = [
        rng.standard_normal(3),
        3 * rng.standard_normal(3),
        q / np.linalg.norm(q),
        2 * rng.standard_normal(3),
    ]
    return np.concatenate([*state, rng.uniform(0.3, 0.8, 4)]), rng.uniform(0.2, 0.9, 4)


FLIP = np.array([1.0, -1.0, -1.0])
ARMS_FLU = np.array([rotor.position_m for rotor in VEHICLE.rotors]) * FLIP
TORQUE_SIGNS = -np.array([1.0 if rotor.spin == "ccw" else -1.0 for rotor in VEHICLE.rotors])


def test_derivative_is_what_rotorpy_computes_with_numbers() -> None:
    multirotor = importlib.import_module("rotorpy.vehicles.multirotor")
    drawn = typical("linear-drag", "quadratic-drag", "thrust-inflow", "translational-lift")
    drag = {"dx": 0.4, "dy": 0.4, "dz": 0.0}  # RotorPy has one k_d, and no drag along z but inflow
    world = dataclasses.replace(drawn, effects={**drawn.effects, "linear-drag": drag})
    mass, hover = VEHICLE.mass_kg, np.sqrt(VEHICLE.mass_kg * 9.81 / 4 / VEHICLE.thrust_max_n) * FULL_RAD_S
    k_eta = VEHICLE.thrust_max_n / FULL_RAD_S**2
    ixx, iyy, izz = VEHICLE.inertia_kg_m2
    theirs = multirotor.Multirotor(
        {
            **{"mass": mass, "Ixx": ixx, "Iyy": iyy, "Izz": izz, "Ixy": 0.0, "Ixz": 0.0, "Iyz": 0.0},
            **{"num_rotors": 4, "rotor_pos": dict(enumerate(ARMS_FLU)), "rotor_directions": TORQUE_SIGNS},
            **{"rotor_speed_min": 0.0, "rotor_speed_max": FULL_RAD_S, "tau_m": VEHICLE.motor_lag_s},
            **{"k_eta": k_eta, "k_m": VEHICLE.torque_per_thrust_m * k_eta},
            **{"k_d": 0.4 * mass / 4 / hover, "k_z": 0.5 * mass / 4 / hover, "k_h": 0.015 * mass / 4},
            **{f"c_D{axis}": 0.03 * mass for axis in "xyz"},
        }
    )
    x, u = random_state()
    q_xyzw = [x[7], -x[8], -x[9], x[6]]
    s = np.concatenate(
        [x[0:3] * FLIP, x[3:6] * FLIP, q_xyzw, x[10:13] * FLIP, np.zeros(3), x[13:17] * FULL_RAD_S]
    )
    d = theirs._s_dot_fn(0.0, s, u * FULL_RAD_S)
    q_wxyz = [d[9], d[6], -d[7], -d[8]]
    expected = [d[0:3] * FLIP, d[3:6] * FLIP, q_wxyz, d[10:13] * FLIP, d[16:20] / FULL_RAD_S]
    np.testing.assert_allclose(
        derivative("rotorpy", world, x, u), np.concatenate(expected), rtol=1e-9, atol=1e-9
    )


def test_derivative_is_what_crazyflow_computes_with_numbers() -> None:
    importlib.import_module("trimtab.sitl.studies.plants.crazyflow_plant")  # makes crazyflow importable
    theirs = importlib.import_module("crazyflow.dynamics.first_principles").dynamics
    x, u = random_state()
    rpm = FULL_RAD_S * 60 / (2 * np.pi)
    k = VEHICLE.thrust_max_n / rpm**2
    left = np.array([0.9, 1.0, 1.0, 1.0])
    mass, J = VEHICLE.mass_kg, np.diag(VEHICLE.inertia_kg_m2)
    hover = np.sqrt(mass * 9.81 / 4 / VEHICLE.thrust_max_n) * FULL_RAD_S
    p, q, v, w, n = theirs(
        x[0:3] * FLIP,
        np.array([x[7], -x[8], -x[9], x[6]]),
        x[3:6] * FLIP,
        x[10:13] * FLIP,
        u * rpm,
        x[13:17] * rpm,
        mass=mass,
        L=np.ones(1),
        prop_inertia=np.full(1, 4.0 * J[0, 0] / hover),
        gravity_vec=np.array([0.0, 0.0, -9.81]),
        J=J,
        J_inv=np.linalg.inv(J),
        rpm2thrust=np.stack([0 * left, 0 * left, k * left], axis=1),
        rpm2torque=np.stack([0 * left, 0 * left, k * VEHICLE.torque_per_thrust_m * left], axis=1),
        mixing_matrix=np.stack([ARMS_FLU[:, 1], -ARMS_FLU[:, 0], TORQUE_SIGNS]),
        drag_matrix=-mass * np.diag([0.4, 0.35, 0.2]),
        rotor_dyn_coef=np.array([[1.0, 0.0, 1.0, 0.0]]) / VEHICLE.motor_lag_s,
    )
    expected = [p * FLIP, v * FLIP, [q[3], q[0], -q[1], -q[2]], w * FLIP, n / rpm]
    world = typical("linear-drag", "rotor-loss", "gyroscopic")
    np.testing.assert_allclose(
        derivative("crazyflow", world, x, u), np.concatenate(expected), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("name", NAMES)
def test_plant_without_effects_moves_as_ours(name: str) -> None:
    ours, theirs = flown(Plant(VEHICLE, QUIET, 1), 20.0), flown(make(name, QUIET), 20.0)
    assert np.abs(ours).max() > 0.5
    np.testing.assert_allclose(theirs, ours, atol=2e-5)


FORMS: Mapping[tuple[str, str], float] = {
    # The delays of our motors differ.
    **dict.fromkeys((("crazyflow", "actuation-delay"), ("rotorpy", "actuation-delay")), 0.7),
    ("crazyflow", "gyroscopic"): 2.0,  # its rotors also push back when they accelerate
    **dict.fromkeys((("crazyflow", "battery-sag"), ("rotorpy", "battery-sag")), 0.6),  # a charge of its own
    **dict.fromkeys((("crazyflow", "mass"), ("rotorpy", "mass")), 0.7),  # ours is bolted on off the centre
}
"""How far a plant may be from ours with the same effect, over the effect, where that is more than usual."""


@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for name in NAMES for kind in sorted(PLANTS[name].effects - SENSED - {"wind"})],
)
def test_effect_acts_with_the_sign_and_size_that_it_has_in_our_plant(name: str, kind: str) -> None:
    height = 0.35 if kind == "ground-effect" else 20.0
    ours = flown(Plant(VEHICLE, typical(kind), 1), height) - flown(Plant(VEHICLE, QUIET, 1), height)
    theirs = flown(make(name, typical(kind)), height) - flown(make(name, QUIET), height)
    v = slice(0, 3) if kind != "gyroscopic" else slice(3, 6)
    size = np.linalg.norm(ours[:, v])
    assert size > 0.02
    assert np.linalg.norm(theirs[:, v] - ours[:, v]) < FORMS.get((name, kind), 0.35) * size


@pytest.mark.parametrize("name", NAMES)
def test_wind_carries_a_vehicle_with_drag_along(name: str) -> None:
    calm, windy = (
        flown(make(name, typical(*kinds)), 20.0) for kinds in (("linear-drag",), ("linear-drag", "wind"))
    )
    # 0.4 1/s times 1.5 m/s for 0.7 s; the rotors, which make the drag in RotorPy, start from rest.
    assert 0.2 < (windy - calm)[-1, 0] < 0.45
    assert 0.2 < (windy - calm)[-1, 1] < 0.45


@pytest.mark.parametrize("name", NAMES)
def test_turbulence_has_the_strength_of_the_world_and_differs_between_flights(name: str) -> None:
    world = dataclasses.replace(
        QUIET, turbulence=Turbulence(force_m_s2=0.1, torque_rad_s2=0.0, correlation_s=0.02)
    )
    felt = []
    for seed in (1, 2):
        plant = make(name, world, seed)
        plant.reset((0.0, 0.0, -1000.0), (1.0, 0.0, 0.0, 0.0))
        rows = []
        for _ in range(4000):
            plant.step((0.0,) * 4)
            rows.append(list(plant.sensed[3:6]))
        felt.append(np.array(rows))
    assert np.std(felt[0], axis=0) == pytest.approx([0.1] * 3, rel=0.2)  # 4 s hold 200 gusts
    assert abs(np.corrcoef(felt[0][:, 0], felt[1][:, 0])[0, 1]) < 0.3


@pytest.mark.parametrize("name", NAMES)
def test_build_deviates_in_a_world_with_tolerances(name: str) -> None:
    drawn = draw_world("empty", load_world("empty")[1], 3, VEHICLE)
    assert drawn.deviations
    still = dataclasses.replace(drawn, turbulence=QUIET.turbulence)
    assert np.abs(flown(make(name, still), 20.0) - flown(make(name, QUIET), 20.0)).max() > 0.01


@pytest.mark.parametrize("name", NAMES)
def test_effect_that_the_plant_cannot_have_is_refused(name: str) -> None:
    with pytest.raises(ForeignPlantError, match="cannot have elastic-tether; choose from actuation-delay"):
        make(name, typical("elastic-tether"))


@pytest.mark.parametrize("name", NAMES)
def test_options_are_refused(name: str) -> None:
    with pytest.raises(ForeignPlantError, match="takes no options; leave out drag"):
        load_foreign_plant(PLANTS[name].spec, VEHICLE, {"drag": 1}, 1)


@pytest.mark.parametrize("name", NAMES)
def test_whole_flight_in_a_quiet_world_is_what_the_nominal_model_predicts(name: str, tmp_path: Path) -> None:
    plan = trimtab.plan(trimtab.load_route("sprint"), vehicle="research")
    reference = trimtab.write_plan(plan, tmp_path / "a.ref")
    flight = trimtab.fly(reference, world="quiet", plant=PLANTS[name].spec, log=tmp_path / "a.mcap")
    error_m = trimtab.predict(None, [trimtab.read_flight(flight.log)]).together.position_rmse_m
    assert error_m < 0.003


@pytest.mark.full
def test_world_of_a_study_is_flown_still_and_traced_in_the_plant(
    tmp_path: Path, short_programme: Programme
) -> None:
    references = plan_references(tmp_path, "research", short_programme)
    world = PlannedWorld(
        name="0000", kind_class="single", kinds=("thrust-gain",), seed=5, turbulence=1.0, plant="rotorpy"
    )
    task = Task(
        world=world,
        folder=tmp_path / "worlds" / "0000",
        references=references,
        ledger=tmp_path / "ledger.json",
        vehicle="research",
        programme=short_programme,
        with_baselines=False,
    )
    Ledger(task.ledger).record("0000", fly(task))
    assert judge(task) == "traced"
    score = read_json(task.folder / "score.json")
    assert score["plant"] == "rotorpy"
    assert set(score["named"]) <= {"thrust-gain", "mass"}
    gain = score["true"]["thrust-gain"]["gain"]
    # RotorPy's thrust coefficient is the gain alone, so the still flights in it give back what was drawn.
    assert gain == pytest.approx(score["drawn"]["thrust-gain"]["gain"], abs=0.005)
