"""How far the plant is from the best fit of the host's form of each effect: near, and never the same.

Two copies of one equation agree to the last digit and prove copying. Each test fits the simple form of an
effect (`trimtab.host.effects`) to what the plant does in flight states like those of a fast figure eight, and
measures what is left over against the size of the effect. Figures are printed with `pytest -s`. What a
form says nothing of (the damping of a turning body by inflow at its hubs) is not in the figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from trimtab.host.codegen import NUMPY
from trimtab.host.effects import Context, load_effects
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.sitl.draw import World, draw_world
from trimtab.sitl.plant import Plant
from trimtab.sitl.plant_constants import plant_parameters
from trimtab.sitl.plant_model import PARAMETERS, PARTS, STATE, TICK_S, tick
from trimtab.sitl.rotors import rotor_speeds
from trimtab.sitl.sensors import Mocap
from trimtab.sitl.surroundings import GRAVITY_M_S2, payload
from trimtab.sitl.vectors import rotation
from trimtab.sitl.world import MocapSettings, WorldFile

COPY = 0.001
ABSURD = 0.15
NEAR = 0.1
LANES = 2000
STATE_SIZE = sum(size for _, size in STATE)
SWINGS_HZ = np.array([0.7, 1.5, 3.0, 6.0])
COMMAND_NOISE = 0.002  # of motor commands within 10 ms, in a simulated flight in the world dead-zone

Effects = Mapping[str, Mapping[str, float]]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("research")


def world(vehicle: Vehicle, effects: Effects) -> World:
    calm = {"force_m_s2": 0.0, "torque_rad_s2": 0.0}
    content = {"description": "test", "tolerances": False, "effects": effects, "turbulence": calm}
    return draw_world("test", WorldFile.model_validate(content), 0, vehicle)


def parameters(vehicle: Vehicle, effects: Effects) -> list[float]:
    values = plant_parameters(vehicle, world(vehicle, effects))
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
    state = [*p, *v, *q, *rate, *speeds, *[np.zeros(LANES)] * (STATE_SIZE - 17)]
    return state, speeds  # the research quad's thrust curve is u^2: a command holds its own rotor speed


def responses(vehicle: Vehicle, effects: Effects) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration in FRD and angular acceleration of every lane over one tick, 3 x lanes each."""
    state, command = flight_states(vehicle)
    zeros = [np.zeros(LANES)] * 6
    inputs = {
        "state": state, "parameters": parameters(vehicle, effects), "command": command, "noise": zeros
    }  # fmt: skip
    out = tick(NUMPY, inputs, PARTS & effects.keys())
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


def best_fit(effect: np.ndarray, columns: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """The best combination of the columns, and the share of the effect it leaves, root mean square."""
    A = np.stack([column.ravel() for column in columns], axis=1)
    fit, *_ = np.linalg.lstsq(A, effect.ravel(), rcond=None)
    return fit, float(np.linalg.norm(effect.ravel() - A @ fit) / np.linalg.norm(effect))


def left_over(effect: np.ndarray, columns: list[np.ndarray], stated: list[float] | None = None) -> float:
    """Share of the effect that the best combination of the columns leaves.

    `stated` is what the world says the combination is: near, for the numbers of a world mean the host's.
    """
    fit, share = best_fit(effect, columns)
    if stated is not None:
        assert fit == pytest.approx(stated, rel=NEAR)
    return share


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
    thrust = sum((vehicle.thrust_max_n * n * n for n in speeds), np.zeros(LANES))
    judge("thrust-gain", left_over(change[2], [thrust]))


def test_com_offset_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"com-offset": {"x": 0.004, "y": -0.003}})[1] - responses(vehicle, {})[1]
    _, speeds = flight_states(vehicle)
    thrust = sum((vehicle.thrust_max_n * n * n for n in speeds), np.zeros(LANES))
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
        inputs = {"state": out["state"], "parameters": values, "command": command, "noise": zeros}
        out = tick(NUMPY, inputs, frozenset({"battery-sag"}))
    ratio = out["sensed"][6] / vehicle.battery.full_v
    thrust = sum(n * n for n in out["state"][13:17])
    nominal = sum(u * u for u in command)
    exponent = float(np.log(thrust / nominal) @ np.log(ratio) / (np.log(ratio) @ np.log(ratio)))
    missing = thrust / nominal - ratio**exponent
    judge("battery-sag", float(np.linalg.norm(missing) / np.linalg.norm(thrust / nominal - 1)))


def swinging(vehicle: Vehicle, swing: float, k: int) -> np.ndarray:
    """Motor commands at tick k that swing by a share of hover at 0.7, 1.5, 3 and 6 Hz."""
    return hover_speed(vehicle) * (1 + swing * np.sin(2 * math.pi * SWINGS_HZ * k * TICK_S))


def thrusts_of_plant(vehicle: Vehicle, swing: float, effects: Effects) -> np.ndarray:
    """Thrust over the greatest one, in two seconds of ticks x four, under `swinging`."""
    state = [np.zeros(4)] * STATE_SIZE
    state[2], state[6] = np.full(4, -100.0), np.ones(4)
    state[13:17] = [np.full(4, hover_speed(vehicle))] * 4
    values, zeros, thrust = parameters(vehicle, effects), [np.zeros(4)] * 6, []
    for k in range(2000):
        command = [swinging(vehicle, swing, k)] * 4
        inputs = {"state": state, "parameters": values, "command": command, "noise": zeros}
        state = tick(NUMPY, inputs, PARTS & effects.keys())["state"]
        thrust.append(state[13] ** 2)
    return np.array(thrust)


def thrusts_of_host(vehicle: Vehicle, swing: float, up_s: float, down_s: float) -> np.ndarray:
    """The same by a first-order lag on thrust, with one time constant to rise and one to fall."""
    thrust, out = np.full(4, hover_speed(vehicle) ** 2), []
    for k in range(2000):
        target = swinging(vehicle, swing, k) ** 2
        lag_s = np.where(target > thrust, up_s, down_s)
        thrust = target + (thrust - target) * np.exp(-TICK_S / lag_s)
        out.append(thrust)
    return np.array(out)


def test_motor_lag_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Thrust under commands that swing at several frequencies against a first-order lag on thrust."""
    slow = thrusts_of_plant(vehicle, 0.2, {"motor-lag": {"extra_s": 0.015}})
    fast = thrusts_of_plant(vehicle, 0.2, {})
    lags = vehicle.motor_lag_s + np.linspace(0.010, 0.020, 41)
    best = min(float(np.linalg.norm(slow - thrusts_of_host(vehicle, 0.2, lag, lag))) for lag in lags)
    judge("motor-lag", best / float(np.linalg.norm(slow - fast)))


def test_uneven_lag_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Thrust under commands that swing at several frequencies against two first-order lags on thrust."""
    uneven = thrusts_of_plant(vehicle, 0.1, {"uneven-lag": {"ratio": 2.0}})
    even = thrusts_of_plant(vehicle, 0.1, {})
    ratios = np.linspace(1.7, 2.3, 31)
    ups = 2 * vehicle.motor_lag_s / (1 + ratios)
    left = [
        float(np.linalg.norm(uneven - thrusts_of_host(vehicle, 0.1, up, ratio * up)))
        for ratio, up in zip(ratios, ups, strict=True)
    ]
    assert ratios[int(np.argmin(left))] == pytest.approx(2.0, rel=NEAR)
    judge("uneven-lag", min(left) / float(np.linalg.norm(uneven - even)))


def test_dead_zone_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Mean settled thrust over commands that vary as within 10 ms of flight, against a smooth zone."""
    rng = np.random.default_rng(9)
    P = plant_parameters(vehicle, world(vehicle, {"dead-zone": {"width": 0.08, "centre": 1.0}}))
    mean = hover_speed(vehicle) * rng.normal(1.0, 0.04, LANES)
    sent = mean[:, None] + rng.normal(0.0, COMMAND_NOISE, (LANES, 200))
    at_once = {**P, "rise_half_tick": [0.0]}
    speed, _ = rotor_speeds(NUMPY, at_once, [0 * sent], [sent], 0.0, 0.0, {"dead-zone"})
    hover = hover_speed(vehicle) ** 2
    seen, commanded = (speed[0] ** 2 / hover).mean(1), (sent**2 / hover).mean(1)

    host = load_effects()["dead-zone"].driven_thrust_n
    assert host is not None
    widths = np.linspace(0.06, 0.1, 81)
    left = [float(np.linalg.norm(seen - host(NUMPY, (width, 1.0), commanded, 1.0))) for width in widths]
    assert widths[int(np.argmin(left))] == pytest.approx(0.08, rel=NEAR)
    judge("dead-zone", min(left) / float(np.linalg.norm(seen - commanded)))


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


def specific_thrust(vehicle: Vehicle) -> np.ndarray:
    _, speeds = flight_states(vehicle)
    return sum((vehicle.thrust_max_n * n * n for n in speeds), np.zeros(LANES)) / vehicle.mass_kg


def hover_speed(vehicle: Vehicle) -> float:
    return math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4 * vehicle.thrust_max_n))


def arms_torque(vehicle: Vehicle, thrust: list[np.ndarray]) -> np.ndarray:
    """Angular acceleration of the nominal vehicle under four thrusts, 3 x lanes."""
    jx, jy, jz = vehicle.inertia_kg_m2
    x, y, z = 0.0, 0.0, 0.0
    for rotor, t in zip(vehicle.rotors, thrust, strict=True):
        px, py, _ = rotor.position_m
        x, y = x - py * t / jx, y + px * t / jy
        z = z + rotor.spin_sign * vehicle.torque_per_thrust_m * t / jz
    return np.array([x, y, z])


def test_translational_lift_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"translational-lift": {"k": 0.015}})[0] - responses(vehicle, {})[0]
    v = body_velocity(vehicle)
    judge("translational-lift", left_over(change[2], [-(v[0] ** 2 + v[1] ** 2)], [0.015]))


def test_thrust_inflow_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"thrust-inflow": {"k": 0.5}})[0] - responses(vehicle, {})[0]
    _, speeds = flight_states(vehicle)
    mean = sum(speeds) / (4 * hover_speed(vehicle))
    judge("thrust-inflow", left_over(change[2], [-body_velocity(vehicle)[2] * mean], [0.5]))


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_rotor_loss_differs_from_the_hosts_form(vehicle: Vehicle, rotor: int) -> None:
    loss = {f"loss_{i}": 0.1 * (i == rotor) for i in (1, 2, 3, 4)}
    lossy, nominal = responses(vehicle, {"rotor-loss": loss}), responses(vehicle, {})
    _, speeds = flight_states(vehicle)
    lost = [-vehicle.thrust_max_n * n * n * (i == rotor) for i, n in enumerate(speeds, 1)]
    force = -sum(lost) / vehicle.mass_kg
    arm = np.linalg.norm(vehicle.rotors[0].position_m) / vehicle.inertia_kg_m2[0] * vehicle.mass_kg
    column = np.vstack([arms_torque(vehicle, lost), arm * force])
    change = np.vstack([lossy[1] - nominal[1], arm * (lossy[0] - nominal[0])[2]])
    judge("rotor-loss", left_over(change, [column], [0.1]))


def test_actuation_delay_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Each rotor under a command that swings at 3 Hz against one delay for all."""
    omega, hover = 2 * math.pi * 3.0, hover_speed(vehicle)

    def speeds(effects: Effects) -> np.ndarray:
        plant = Plant(vehicle, world(vehicle, effects), 0)
        plant.reset((0.0, 0.0, -100.0), (1.0, 0.0, 0.0, 0.0))
        out = []
        for k in range(1500):
            plant.step([hover * (1 + 0.2 * math.sin(omega * k * TICK_S))] * 4)
            out.append(list(plant.state[13:17]))
        return np.array(out[500:])

    late, prompt = speeds({"actuation-delay": {"delay_s": 0.0063}}), speeds({})
    swing = np.sin(omega * TICK_S * np.arange(500, 1500)), np.cos(omega * TICK_S * np.arange(500, 1500))
    basis = np.stack([*swing, np.ones(1000)], axis=1)
    sine, cosine, mean = np.linalg.lstsq(basis, prompt[:, 0], rcond=None)[0]

    def host(delay_s: float) -> np.ndarray:
        shifted = omega * (TICK_S * np.arange(500, 1500) - delay_s)
        return mean + sine * np.sin(shifted) + cosine * np.cos(shifted)

    left = [np.linalg.norm(late - host(d)[:, None]) for d in np.linspace(0.005, 0.008, 61)]
    assert 0.005 + 5e-5 * int(np.argmin(left)) == pytest.approx(0.0063, rel=NEAR)
    judge("actuation-delay", float(min(left)) / float(np.linalg.norm(late - prompt)))


def test_frame_tilt_differs_from_the_hosts_form() -> None:
    """Positions and attitudes of poses all over the room against one turn of the frame."""
    rng, tilt = np.random.default_rng(8), (0.012, -0.009)
    settings = MocapSettings(position_noise_m=0.0, attitude_noise_deg=0.0, dropout=0.0)
    moved, turned, columns = [], [], []
    for p in rng.uniform((-2.5, -2.5, -2.0), (2.5, 2.5, -0.8), (200, 3)):
        camera = Mocap(settings, 0.0, np.random.default_rng(0), tilt)
        q = rng.standard_normal(4)
        q = q / np.linalg.norm(q)
        for now_us in range(0, 20_000, 1000):
            camera.tick(now_us, (*p, 0.0, 0.0, 0.0, *q), (0.0, 0.0, 0.0))
        seen = camera.read()[0]
        between = np.reshape(rotation(seen.q_ned_frd), (3, 3)) @ np.reshape(rotation(tuple(q)), (3, 3)).T
        moved.append(np.array(seen.p_ned) - p)
        turned.append(0.5 * np.array([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0]]))
        columns.append([[0.0, -p[2], p[1], 1.0, 0.0], [p[2], 0.0, -p[0], 0.0, 1.0]])
    effect = np.hstack([np.array(moved), np.array(turned)])
    x, y = np.moveaxis(np.array(columns), 1, 0)
    # gravity then leans to (g tilt_y, -g tilt_x), as the host has it
    judge("frame-tilt", left_over(effect, [x, y], list(tilt)))


def test_ground_effect_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"ground-effect": {"k": 0.012}})[0] - responses(vehicle, {})[0]
    state, _ = flight_states(vehicle)
    height, thrust = -state[2], specific_thrust(vehicle)
    sizes = np.linspace(0.004, 0.02, 161)
    left = [np.linalg.norm(change[2] + thrust * (1 / (1 - k / height**2) - 1)) for k in sizes]
    assert sizes[int(np.argmin(left))] == pytest.approx(0.012, rel=2 * NEAR)
    judge("ground-effect", float(min(left)) / float(np.linalg.norm(change[2])))


def test_inertia_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    heavy = responses(vehicle, {"inertia": {"x": 1.2, "y": 0.85, "z": 1.15}})[1]
    nominal = responses(vehicle, {})[1]
    state, _ = flight_states(vehicle)
    w, J = np.array(state[10:13]), np.array(vehicle.inertia_kg_m2)
    torque = J[:, None] * nominal + np.cross(w, J[:, None] * w, axis=0)
    # torque = J' turning + w x J' w is linear in the three moments J'
    turned = [np.eye(3)[:, [k]] * heavy + np.cross(w, np.eye(3)[:, [k]] * w, axis=0) for k in range(3)]
    A = np.stack([column.ravel() for column in turned], axis=1)
    moments, *_ = np.linalg.lstsq(A, torque.ravel(), rcond=None)
    missing = (torque - sum(j * column for j, column in zip(moments, turned, strict=True))) / J[:, None]
    assert moments / J == pytest.approx([1.2, 0.85, 1.15], rel=0.5 * NEAR)
    judge("inertia", float(np.linalg.norm(missing) / np.linalg.norm(heavy - nominal)))


def test_gyroscopic_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    change = responses(vehicle, {"gyroscopic": {"h": 4.0}})[1] - responses(vehicle, {})[1]
    state, speeds = flight_states(vehicle)
    jx, jy, _ = vehicle.inertia_kg_m2
    spins = [rotor.spin_sign for rotor in vehicle.rotors]
    surplus = jx * sum(s * n for s, n in zip(spins, speeds, strict=True)) / hover_speed(vehicle)
    column = np.array([surplus * state[11] / jx, -surplus * state[10] / jy])
    # -w x L, and the L of a rotor that turns counter-clockwise seen from above points up
    judge("gyroscopic", left_over(change[:2], [column], [4.0]))


def test_torque_bias_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    effects = {"torque-bias": {"x": 2.0, "y": -1.5, "z": 1.2}}
    change = responses(vehicle, effects)[1] - responses(vehicle, {})[1]
    judge(
        "torque-bias",
        left_over(change, [np.eye(3)[:, [k]] * np.ones(LANES) for k in range(3)], [2.0, -1.5, 1.2]),
    )


def test_mass_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Acceleration of the origin, where the cameras look, and turning; the host's is thrust over mass."""
    effects = {"mass": {"factor": 1.1}}
    heavy, nominal = responses(vehicle, effects), responses(vehicle, {})
    com = np.array(plant_parameters(vehicle, world(vehicle, effects))["com_frd"])[:, None]
    w = np.array(flight_states(vehicle)[0][10:13])
    carried = np.cross(heavy[1], com, axis=0) + np.cross(w, np.cross(w, com, axis=0), axis=0)
    thrust = np.zeros((3, LANES))
    thrust[2] = specific_thrust(vehicle)
    judge("mass", left_over(heavy[0] - carried - nominal[0], [thrust], [1 - 1 / 1.1]))


def test_slung_payload_differs_from_the_hosts_form(vehicle: Vehicle) -> None:
    """Force of the line under a vehicle carried along a small figure eight, against the host's own states."""
    ratio, length, h = 0.08, 0.7, TICK_S
    payload_there = {"ratio": ratio, "length_m": length, "damping": 0.04}
    P = plant_parameters(vehicle, world(vehicle, {"slung-payload": payload_there}))
    t = h * np.arange(9000)
    swing = np.clip(t / 3.0, 0.0, 1.0) ** 3
    x, y, z = 0.7 * np.sin(1.1 * t), 0.35 * np.sin(2.2 * t), -0.1 * np.cos(1.1 * t) - 2.0
    path = np.stack([swing * x, swing * y, z])
    speed = np.gradient(path, h, axis=1)
    place, v, force = np.array([*path[:2, 0], path[2, 0] + length + 0.006]), np.zeros(3), []
    for k in range(len(t)):
        a, line = payload(NUMPY, P, tuple(path[:, k]), tuple(speed[:, k]), tuple(place), tuple(v), (0.0, 0.0))
        v = v + h * np.array(a)
        place = place + h * v
        force.append(np.array(line) / vehicle.mass_kg)
    seen = np.array(force)[1000:]

    felt = np.array([[0.0], [0.0], [GRAVITY_M_S2]]) - np.gradient(speed, h, axis=1)
    lengths, tension_shares = (v.ravel() for v in np.meshgrid(np.linspace(0.6, 0.8, 21), [0.0, 0.5, 1.0]))
    effect = load_effects()["slung-payload"]
    light = 1e-9  # the thrust alone carries the vehicle
    assert effect.memory_rates is not None
    assert effect.specific_force_frd is not None
    theta = (light, lengths, 0.04, tension_shares)
    memory, host = [np.zeros(len(lengths))] * 6, []
    for k in range(len(t)):
        g, p_ned, v_ned = felt[:, k], path[:, k].tolist(), speed[:, k].tolist()
        thrust = float(np.linalg.norm(g))
        R = Rotation.align_vectors(g[None], [[0.0, 0.0, thrust]])[0].as_matrix()
        ctx = Context(
            p_ned=p_ned, v_ned=v_ned, v_air_frd=v_ned, R=R.ravel().tolist(), rate_frd=(0.0,) * 3,
            thrust=(thrust / 4,) * 4, collective_n=thrust, mass_kg=1.0, voltage_ratio=1.0, t_s=0.0,
            rotor_positions=(), spin_signs=(), inertia_kg_m2=(), hover_n=1.0, memory=memory,
            a_ned=(np.array([0.0, 0.0, GRAVITY_M_S2]) - g).tolist(),
        )  # fmt: skip
        host.append(R @ np.array(effect.specific_force_frd(NUMPY, theta, ctx)) / light)
        rates = effect.memory_rates(NUMPY, theta, ctx)
        memory = [state + h * rate for state, rate in zip(memory, rates, strict=True)]
    pulls = np.array(host)[1000:]
    judge("slung-payload", min(left_over(seen, [pulls[:, :, k]], [ratio]) for k in range(len(lengths))))
