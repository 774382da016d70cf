"""How far the plant is from the best fit of the host's form of each effect: near, and never the same.

Two copies of one equation agree to the last digit and prove copying. Each test fits the simple form of an
effect (`host.effects`) to what the plant does in flight states like those of a fast figure eight, and
measures what is left over against the size of the effect. Figures are printed with `pytest -s`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from host.codegen import NUMPY
from host.vehicle import Vehicle, load_vehicle
from sitl.draw import draw_world
from sitl.plant import plant_parameters
from sitl.plant_model import GRAVITY_M_S2, PARAMETERS, TICK_S, rotation, tick
from sitl.sensors import Mocap
from sitl.world import MocapSettings, WorldFile

COPY = 0.001
ABSURD = 0.15
LANES = 2000

Effects = Mapping[str, Mapping[str, float]]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("research")


def parameters(vehicle: Vehicle, effects: Effects) -> list[float]:
    file = WorldFile.model_validate({"description": "test", "tolerances": False, "effects": effects})
    values = plant_parameters(vehicle, draw_world("test", file, 0, vehicle))
    return [number for name, _ in PARAMETERS for number in values[name]]


def flight_states(vehicle: Vehicle) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """States and commands in lanes: up to 4 m/s, 35 degrees of tilt, thrust within a third of hover."""
    rng = np.random.default_rng(5)
    azimuth, speed = rng.uniform(0, 2 * math.pi, LANES), rng.uniform(1.0, 4.0, LANES)
    v = [speed * np.cos(azimuth), speed * np.sin(azimuth), rng.normal(0, 0.5, LANES)]
    p = [rng.uniform(-2, 2, LANES), rng.uniform(-2, 2, LANES), rng.uniform(-2.0, -0.8, LANES)]
    tilt, towards = rng.uniform(0, math.radians(35), LANES), rng.uniform(0, 2 * math.pi, LANES)
    q = [np.cos(tilt / 2), np.sin(tilt / 2) * np.cos(towards), np.sin(tilt / 2) * np.sin(towards), 0 * tilt]
    rate = [rng.normal(0, 1.0, LANES) for _ in range(3)]
    hover = math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4 * vehicle.thrust_max_n))
    together = rng.uniform(0.85, 1.15, LANES)
    speeds = [hover * together * rng.normal(1, 0.015, LANES) for _ in range(4)]
    state = [*p, *v, *q, *rate, *speeds, np.zeros(LANES), *[np.zeros(LANES)] * 12]
    return state, speeds  # the research quad's thrust curve is u^2: a command holds its own rotor speed


def responses(vehicle: Vehicle, effects: Effects) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration in FRD and angular acceleration of every lane over one tick, 3 x lanes each."""
    state, command = flight_states(vehicle)
    zeros = [np.zeros(LANES)] * 6
    inputs = {
        "state": state, "parameters": parameters(vehicle, effects), "command": command, "noise": zeros
    }  # fmt: skip
    out = tick(NUMPY, inputs)
    a = [(after - before) / TICK_S for before, after in zip(state[3:6], out["state"][3:6], strict=True)]
    turning = [
        (after - before) / TICK_S for before, after in zip(state[10:13], out["state"][10:13], strict=True)
    ]
    return np.array(into_body(state, a)), np.array(turning)


def into_body(state: list[np.ndarray], u: list[np.ndarray]) -> list[np.ndarray]:
    R = rotation(state[6:10])
    return [R[i] * u[0] + R[3 + i] * u[1] + R[6 + i] * u[2] for i in range(3)]


def body_velocity(vehicle: Vehicle) -> np.ndarray:
    state, _ = flight_states(vehicle)
    return np.array(into_body(state, state[3:6]))


def left_over(effect: np.ndarray, columns: list[np.ndarray]) -> float:
    """Share of the effect that the best combination of the columns leaves, root mean square."""
    A = np.stack([column.ravel() for column in columns], axis=1)
    fit, *_ = np.linalg.lstsq(A, effect.ravel(), rcond=None)
    return float(np.linalg.norm(effect.ravel() - A @ fit) / np.linalg.norm(effect))


def judge(name: str, share: float) -> None:
    print(f"{name}: the host's best fit leaves {100 * share:.2f} % of the effect")
    assert COPY < share < ABSURD


def test_linear_drag_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    effects = {"linear-drag": {"dx": 0.4, "dy": 0.35, "dz": 0.2}}
    change = responses(vehicle, effects)[0] - responses(vehicle, {})[0]
    v = body_velocity(vehicle)
    axes = [np.eye(3)[:, [k]] * v for k in range(3)]
    judge("linear-drag", left_over(change, axes))


def test_quadratic_drag_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"quadratic-drag": {"c": 0.03}})[0] - responses(vehicle, {})[0]
    v = body_velocity(vehicle)
    judge("quadratic-drag", left_over(change, [np.linalg.norm(v, axis=0) * v]))


def test_wind_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    drag = {"linear-drag": {"dx": 0.4, "dy": 0.35, "dz": 0.2}}
    windy = {**drag, "wind": {"wx": 1.2, "wy": -0.9}}
    change = responses(vehicle, windy)[0] - responses(vehicle, drag)[0]
    state, _ = flight_states(vehicle)
    one, nought = np.ones(LANES), np.zeros(LANES)
    columns = []
    for direction in ([one, nought, nought], [nought, one, nought]):
        seen = np.array(into_body(state, direction))
        columns.append(np.array([[0.4], [0.35], [0.2]]) * seen)
    judge("wind", left_over(change, columns))


def test_thrust_gain_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"thrust-gain": {"gain": 0.92}})[0] - responses(vehicle, {})[0]
    _, speeds = flight_states(vehicle)
    thrust = sum(vehicle.thrust_max_n * n * n for n in speeds)
    judge("thrust-gain", left_over(change[2], [thrust]))


def test_com_offset_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"com-offset": {"x": 0.004, "y": -0.003}})[1] - responses(vehicle, {})[1]
    _, speeds = flight_states(vehicle)
    thrust = sum(vehicle.thrust_max_n * n * n for n in speeds)
    jx, jy, _ = vehicle.inertia_kg_m2
    nought = np.zeros(LANES)
    columns = [np.array([nought, -thrust / jy, nought]), np.array([thrust / jx, nought, nought])]
    judge("com-offset", left_over(change, columns))


def test_battery_sag_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Settled thrust at several charges and throttles against a power of the voltage ratio."""
    state, command = flight_states(vehicle)
    rng = np.random.default_rng(6)
    values = parameters(vehicle, {"battery-sag": {"exponent": 1.7}})
    state[17] = rng.uniform(0, 0.5, LANES) * vehicle.battery.capacity_ah * 3600
    zeros = [np.zeros(LANES)] * 6
    out: dict[str, list[np.ndarray]] = {"state": state}
    for _ in range(300):
        out = tick(NUMPY, {"state": out["state"], "parameters": values, "command": command, "noise": zeros})
    ratio = out["sensed"][6] / vehicle.battery.full_v
    thrust = sum(n * n for n in out["state"][13:17])
    nominal = sum(u * u for u in command)
    exponent = float(np.log(thrust / nominal) @ np.log(ratio) / (np.log(ratio) @ np.log(ratio)))
    missing = thrust / nominal - ratio**exponent
    judge("battery-sag", float(np.linalg.norm(missing) / np.linalg.norm(thrust / nominal - 1)))


def test_motor_lag_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Thrust under commands that swing at several frequencies against a first-order lag on thrust."""
    frequency = np.array([0.7, 1.5, 3.0, 6.0])
    hover = math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4 * vehicle.thrust_max_n))

    def plant(effects: Effects) -> np.ndarray:
        state = [np.zeros(4)] * 30
        state[2], state[6] = np.full(4, -100.0), np.ones(4)
        state[13:17] = [np.full(4, hover)] * 4
        values, zeros, thrust = parameters(vehicle, effects), [np.zeros(4)] * 6, []
        for k in range(2000):
            u = hover * (1 + 0.2 * np.sin(2 * math.pi * frequency * k * TICK_S))
            inputs = {"state": state, "parameters": values, "command": [u] * 4, "noise": zeros}
            state = tick(NUMPY, inputs)["state"]
            thrust.append(state[13] ** 2)
        return np.array(thrust)

    def host(lag_s: float) -> np.ndarray:
        thrust, out = np.full(4, hover**2), []
        for k in range(2000):
            u = hover * (1 + 0.2 * np.sin(2 * math.pi * frequency * k * TICK_S))
            thrust = u * u + (thrust - u * u) * math.exp(-TICK_S / lag_s)
            out.append(thrust)
        return np.array(out)

    slow, fast = plant({"motor-lag": {"extra_s": 0.015}}), plant({})
    lags = vehicle.motor_lag_s + np.linspace(0.010, 0.020, 41)
    best = min(float(np.linalg.norm(slow - host(lag))) for lag in lags)
    judge("motor-lag", best / float(np.linalg.norm(slow - fast)))


def test_mocap_latency_differs_from_the_hosts_form() -> None:
    """Poses of a vehicle that swings by 1.5 m at 0.35 Hz against where it was a constant time before."""
    settings = MocapSettings(position_noise_m=0.0, attitude_noise_deg=0.0, dropout=0.0)
    camera = Mocap(settings, 0.015, np.random.default_rng(7))
    omega = 2 * math.pi * 0.35
    poses = []
    for now_us in range(0, 10_000_000, 1000):
        t = now_us * 1e-6
        pose = (1.5 * math.sin(omega * t), 0.0, -1.0, 1.5 * omega * math.cos(omega * t), 0, 0, 1, 0, 0, 0)
        if now_us >= camera.due_us:
            camera.tick(now_us, pose, (0.0, 0.0, 0.0))
        poses += camera.read()
    stamp = np.array([pose.stamp_us * 1e-6 for pose in poses])
    seen = np.array([pose.p_ned[0] for pose in poses])
    honest = 1.5 * np.sin(omega * stamp)
    lags = np.linspace(0.013, 0.017, 81)
    best = min(float(np.linalg.norm(seen - 1.5 * np.sin(omega * (stamp - lag)))) for lag in lags)
    judge("mocap-latency", best / float(np.linalg.norm(seen - honest)))
