"""The simulated vehicle's body: a compiled tick with the constants of one world and one flight."""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, Protocol

import numpy as np

from host.codegen import CompiledEngine, function_engine, sx_function
from host.vehicle import Vehicle
from sitl.draw import World
from sitl.plant_model import INPUTS, OUTPUTS, PARAMETERS, PARTS, STATE, TICK_S, Block, tick
from sitl.seeds import Purpose, flight_generator
from sitl.surroundings import GRAVITY_M_S2, LINE_STRETCH_M
from sitl.vectors import rotation

_SINK_M = 5e-4  # how far the resting vehicle presses its feet into the floor
_FLOOR_DAMPING = 0.7
_CELL_RESISTANCE_OHM_AH = 0.012  # of one cell, times its capacity
_HOVER_POWER_W_PER_N = 15.0
_SAG_START_DEPTH = 0.4  # flights in a world with battery-sag start full, down to this, or in between
_BATTERY_SHARE = 0.3  # of the mass: the part that slid when the centre of mass is off
_LAG_UNEVEN = 0.05  # a motor slower than its file brakes even more slowly than it speeds up
_NOISE_BLOCK = 1024
_DELAY_SPREAD = (0.05, -0.03, -0.05, 0.03)  # of each motor controller's delay
_AIR_DENSITY_KG_M3 = 1.2
_DISC_SHARE = 0.7  # of half the way to the next hub: a rotor's radius
_INERTIA_PRODUCTS = (0.03, 0.05, -0.04)  # xy, xz, yz that come with wrong moments, share of the change
_BOLTED_FRD = (0.004, -0.003, 0.03)  # where what makes the mass wrong sits
_MOMENTUM_SPREAD = (0.0015, -0.001, 0.001, -0.0015)  # of each rotor's angular momentum
_LYING_AT_M = (-0.12, 0.05)  # of a payload on the floor, from the vehicle


class PlantPort(Protocol):
    """What the session needs of a plant, this one or a foreign one.

    `pose` holds p_ned, v_ned of the origin and q_ned_frd (w first); `sensed` body rate and specific force
    in FRD and the battery's voltage: doubles, renewed by every step, the same memory for life.
    """

    @property
    def pose(self) -> Any: ...
    @property
    def sensed(self) -> Any: ...

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None: ...
    def step(self, motor_command: Sequence[float]) -> None: ...


class Plant:
    """A vehicle in a world, stepped a millisecond at a time. Satisfies PlantPort.

    `state` is the memory of `plant_model.STATE` after the last step; `reset` comes first.
    """

    def __init__(self, vehicle: Vehicle, world: World, flight: int) -> None:
        self._engine = plant_engine(PARTS.intersection(world.effects))
        inputs: Any = self._engine.inputs
        outputs: Any = self._engine.outputs
        self._state, self._command, self._noise = inputs["state"], inputs["command"], inputs["noise"]
        self.state = outputs["state"]
        self.pose = outputs["pose"]
        self.sensed = outputs["sensed"]
        values = plant_parameters(vehicle, world)
        inputs["parameters"][:] = pack(PARAMETERS, values)
        self._full_v = values["battery"][0]
        self._calm = world.turbulence.force_m_s2 == 0.0 and world.turbulence.torque_rad_s2 == 0.0
        self._rng = flight_generator(world.seed, flight, Purpose.TURBULENCE)
        self._charge_used_c = 0.0
        if "battery-sag" in world.effects:
            depth = flight_generator(world.seed, flight, Purpose.BATTERY).uniform(0.0, _SAG_START_DEPTH)
            self._charge_used_c = depth * values["battery"][3]
        self._com_frd = values["com_frd"]
        self._line_m = values["payload"][1]
        delay_ticks = world.value("actuation-delay", "delay_s") / TICK_S
        self._delays = [(i, *_whole_and_part(delay_ticks * (1.0 + e))) for i, e in enumerate(_DELAY_SPREAD)]
        self._delayed = delay_ticks > 0.0
        longest = int(max(whole for _, whole, _ in self._delays))
        self._sent: deque[Sequence[float]] = deque(maxlen=longest + 2)
        self._gust_sd = (world.turbulence.force_m_s2, world.turbulence.torque_rad_s2)
        self._block = memoryview(b"")
        self._at = self._end = 0

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Nothing comes back; the origin is put at rest at a pose, rotors stopped, turbulence as usual.

        At z_ned = 0 the feet stand on the floor.
        """
        R, com = rotation(q_ned_frd), self._com_frd
        p = [p_ned[i] + sum(R[3 * i + k] * com[k] for k in range(3)) for i in range(3)]
        if p_ned[2] == 0.0:
            p[2] += _SINK_M
        force, torque = self._gust_sd
        gust = self._rng.standard_normal(6) * ([force] * 3 + [torque] * 3)
        state = {
            "p_ned": p,
            "v_ned": [0.0] * 3,
            "q_ned_frd": q_ned_frd,
            "rate_frd": [0.0] * 3,
            "rotor_speed": [0.0] * 4,
            "charge_used_c": [self._charge_used_c],
            "gust": gust,
            "acceleration_ned": [0.0] * 3,
            "turning_frd": [0.0] * 3,
            "payload_ned": [*self._hanging(p_ned), 0.0, 0.0, 0.0],
            "slide": [0.0, 0.0],
        }
        self.state[:] = pack(STATE, state)
        self._at = self._end = 0
        self._sent.extend([(0.0, 0.0, 0.0, 0.0)] * (self._sent.maxlen or 0))
        self.pose[:] = memoryview(array("d", [*p_ned, 0.0, 0.0, 0.0, *q_ned_frd]))
        self.sensed[:] = memoryview(array("d", [0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY_M_S2, self._full_v]))

    def step(self, motor_command: Sequence[float]) -> None:
        """Nothing comes back; one millisecond passes with the commands, 0..1 a rotor, held."""
        at = self._at
        if at == self._end and not self._calm:
            self._draw_noise()
            at = 0
        command = self._command
        if self._delayed:
            sent = self._sent
            sent.appendleft(tuple(motor_command))
            for i, whole, part in self._delays:
                new = sent[whole][i]
                command[i] = new + part * (sent[whole + 1][i] - new)
        else:
            command[0], command[1], command[2], command[3] = motor_command
        if not self._calm:
            self._at = after = at + 6
            self._noise[:] = self._block[at:after]
        self._state[:] = self.state
        self._engine()

    def _hanging(self, p_ned: Sequence[float]) -> list[float]:
        """Where a payload is at the start: under the vehicle, or on the floor beside it."""
        x, y, z = p_ned
        if z + self._line_m < 0.0:
            return [x, y, z + self._line_m + LINE_STRETCH_M]
        return [x + _LYING_AT_M[0], y + _LYING_AT_M[1], 0.0]

    def _draw_noise(self) -> None:
        self._block = self._rng.standard_normal(6 * _NOISE_BLOCK).data
        self._end = 6 * _NOISE_BLOCK


@lru_cache(maxsize=32)
def _traced(parts: frozenset[str]) -> Any:
    return sx_function(partial(tick, parts=parts), INPUTS, OUTPUTS, "plant")


def plant_engine(parts: frozenset[str] = PARTS) -> CompiledEngine:
    """The tick of a world with these of `plant_model.PARTS`, with memory of its own.

    Compiled or not as `host.codegen` chooses.
    """
    return function_engine(_traced(parts), INPUTS, OUTPUTS)


def plant_parameters(vehicle: Vehicle, world: World) -> dict[str, list[float]]:
    """The plant's constants by the names of `plant_model.PARAMETERS`, from vehicle file and world."""
    value = world.value
    mass = vehicle.mass_kg * value("mass", "factor")
    com, inertia = _mass_properties(vehicle, world)
    weight = vehicle.mass_kg * GRAVITY_M_S2
    inflow = _hover_inflow(vehicle)
    lag = vehicle.motor_lag_s + value("motor-lag", "extra_s")
    ratio = value("uneven-lag", "ratio")
    uneven = (ratio - 1.0) / (ratio + 1.0) + (_LAG_UNEVEN if "motor-lag" in world.effects else 0.0)
    spins = [1.0 if rotor.spin == "ccw" else -1.0 for rotor in vehicle.rotors]
    stiffness = weight / (4.0 * _SINK_M)
    battery, turbulence = vehicle.battery, world.turbulence
    keep = math.exp(-TICK_S / turbulence.correlation_s)
    fresh = math.sqrt(1.0 - keep * keep)
    hover = weight / (4.0 * vehicle.thrust_max_n)
    c1, c2 = vehicle.thrust_curve
    hover_command = 2.0 * hover / (c1 + math.sqrt(c1 * c1 + 4.0 * c2 * hover))
    wheel = value("gyroscopic", "h") * vehicle.inertia_kg_m2[0]
    slope = value("shifting-battery", "slope")
    return {
        "mass_kg": [mass],
        "inertia": _six(inertia),
        "inertia_inverse": _six(np.linalg.inv(inertia)),
        "com_frd": com.tolist(),
        "rotors_frd": [c for rotor in vehicle.rotors for c in rotor.position_m],
        "spins": spins,
        "thrust_max_n": [vehicle.thrust_max_n],
        "thrust_curve": list(vehicle.thrust_curve),
        "torque_per_thrust_m": [vehicle.torque_per_thrust_m],
        "hover_speed": [math.sqrt(hover)],
        "rise_half_tick": [math.exp(-0.5 * TICK_S / (lag * (1.0 - uneven)))],
        "fall_half_tick": [math.exp(-0.5 * TICK_S / (lag * (1.0 + uneven)))],
        "thrust_gain": [value("thrust-gain", "gain")],
        "linear_drag": [value("linear-drag", key) for key in ("dx", "dy", "dz")],
        "quadratic_drag": [value("quadratic-drag", "c")],
        "wind_ned": [value("wind", key) for key in ("wx", "wy")],
        "flapping": [value("blade-flapping", "moment")],
        "tether": [
            value("elastic-tether", key)
            for key in ("stiffness", "damping", "slack_m", "anchor_x_m", "anchor_y_m", "anchor_z_m")
        ],
        "floor": [stiffness, 2.0 * _FLOOR_DAMPING * math.sqrt(stiffness * vehicle.mass_kg / 4.0)],
        "sag_exponent": [value("battery-sag", "exponent")],
        "battery": [
            battery.full_v,
            battery.empty_v,
            battery.cells * _CELL_RESISTANCE_OHM_AH / battery.capacity_ah,
            battery.capacity_ah * 3600.0,
            _HOVER_POWER_W_PER_N * weight,
        ],
        "gust": [keep, fresh * turbulence.force_m_s2, fresh * turbulence.torque_rad_s2],
        "hover_inflow": [inflow, inflow**4],
        "translational_lift": [value("translational-lift", "k") * vehicle.mass_kg * inflow],
        "thrust_inflow": [0.25 * value("thrust-inflow", "k") * vehicle.mass_kg],
        "rotor_loss": [value("rotor-loss", f"loss_{i}") for i in (1, 2, 3, 4)],
        "ground_effect": [value("ground-effect", "k")],
        "gyroscopic": [wheel * s * (1.0 + e) for s, e in zip(spins, _MOMENTUM_SPREAD, strict=True)],
        "torque_bias": [
            j * value("torque-bias", axis) for j, axis in zip(vehicle.inertia_kg_m2, "xyz", strict=True)
        ],
        "hover_thrust_n": [weight],
        "cant": [c for i in (1, 2, 3, 4) for c in _canted(value, i)],
        "dead_zone": [value("dead-zone", "centre") * hover_command, value("dead-zone", "width")],
        "fan": [
            *(value("fan", key) for key in ("push_m_s2", "width_m", "x_m", "y_m")),
            *_north_east(value("fan", "towards")),
        ],
        "wall": [
            *(value("wall-suction", key) for key in ("pull_m_s2", "distance_m")),
            *_north_east(value("wall-suction", "towards")),
        ],
        "payload": [value("slung-payload", "ratio") * vehicle.mass_kg, value("slung-payload", "length_m")],
        "slide": [
            *(value("shifting-battery", key) for key in ("share", "stiffness")),
            math.cos(slope),
            math.sin(slope),
        ],
    }


def _mass_properties(vehicle: Vehicle, world: World) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass in FRD and inertia about it.

    Where the centre of mass is off the origin, the battery has slid there. What makes the mass wrong is
    bolted on below, wrong moments come with products: the inertia follows.
    """
    factor = world.value("mass", "factor")
    mass = vehicle.mass_kg * factor
    nominal = np.array(vehicle.inertia_kg_m2)
    wrong = np.array([world.value("inertia", axis) for axis in "xyz"]) - 1.0
    inertia = np.diag(nominal * (1.0 + wrong))
    for (i, k), share in zip(((0, 1), (0, 2), (1, 2)), _INERTIA_PRODUCTS, strict=True):
        inertia[i, k] = inertia[k, i] = share * np.linalg.norm(wrong) * math.sqrt(nominal[i] * nominal[k])
    slid = np.array([world.value("com-offset", "x"), world.value("com-offset", "y"), 0.0])
    inertia += mass * (1.0 / _BATTERY_SHARE - 1.0) * _spread(slid)
    bolted = np.array(_BOLTED_FRD)
    inertia += vehicle.mass_kg * (1.0 - 1.0 / factor) * _spread(bolted)
    return slid + (1.0 - 1.0 / factor) * bolted, inertia


def _spread(r: np.ndarray) -> np.ndarray:
    """Inertia of a unit mass at r."""
    return r @ r * np.eye(3) - np.outer(r, r)


def _hover_inflow(vehicle: Vehicle) -> float:
    """Induced velocity of a hovering rotor, m/s, by momentum theory; radius guessed from the hubs' places."""
    hubs = [np.array(rotor.position_m) for rotor in vehicle.rotors]
    nearest = min(float(np.linalg.norm(a - hubs[0])) for a in hubs[1:])
    area = math.pi * (_DISC_SHARE * 0.5 * nearest) ** 2
    return math.sqrt(0.25 * vehicle.mass_kg * GRAVITY_M_S2 / (2.0 * _AIR_DENSITY_KG_M3 * area))


def _canted(value: Callable[[str, str], float], i: int) -> list[float]:
    """Direction of rotor i's thrust in FRD."""
    cant, towards = value("motor-cant", f"cant_{i}"), value("motor-cant", f"towards_{i}")
    side = math.sin(cant)
    return [side * math.cos(towards), side * math.sin(towards), -math.cos(cant)]


def _north_east(towards: float) -> tuple[float, float]:
    return math.cos(towards), math.sin(towards)


def _whole_and_part(ticks: float) -> tuple[int, float]:
    whole = math.floor(ticks)
    return whole, ticks - whole


def pack(layout: Sequence[Block], values: Mapping[str, Sequence[float]]) -> memoryview:
    """The numbers of `values` as one vector in the order of `layout`. Raises ValueError for a wrong size."""
    for name, size in layout:
        if len(values[name]) != size:
            raise ValueError(f"{name} holds {len(values[name])} numbers, not {size}")
    return memoryview(array("d", [float(number) for name, _ in layout for number in values[name]]))


def _six(tensor: np.ndarray) -> list[float]:
    return [float(tensor[i, k]) for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
