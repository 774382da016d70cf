"""The simulated vehicle's body: a compiled tick with the constants of one world and one flight."""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from host.codegen import CompiledEngine, function_engine, sx_function
from host.vehicle import Vehicle
from sitl.draw import World
from sitl.plant_model import GRAVITY_M_S2, INPUTS, OUTPUTS, PARAMETERS, STATE, TICK_S, Block, rotation, tick
from sitl.seeds import Purpose, flight_generator

_SINK_M = 5e-4  # how far the resting vehicle presses its feet into the floor
_FLOOR_DAMPING = 0.7
_CELL_RESISTANCE_OHM_AH = 0.012  # of one cell, times its capacity
_HOVER_POWER_W_PER_N = 15.0
_SAG_START_DEPTH = 0.4  # flights in a world with battery-sag start full, down to this, or in between
_BATTERY_SHARE = 0.3  # of the mass: the part that slid when the centre of mass is off
_LAG_UNEVEN = 0.05  # a motor slower than its file brakes even more slowly than it speeds up
_NOISE_BLOCK = 1024


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
        self._engine = plant_engine()
        inputs: Any = self._engine.inputs
        outputs: Any = self._engine.outputs
        self._state, self._command, self._noise = inputs["state"], inputs["command"], inputs["noise"]
        self.state = outputs["state"]
        self.pose = outputs["pose"]
        self.sensed = outputs["sensed"]
        values = plant_parameters(vehicle, world)
        inputs["parameters"][:] = pack(PARAMETERS, values)
        self._full_v = values["battery"][1]
        self._calm = world.turbulence.force_m_s2 == 0.0 and world.turbulence.torque_rad_s2 == 0.0
        self._rng = flight_generator(world.seed, flight, Purpose.TURBULENCE)
        self._charge_used_c = 0.0
        if values["battery"][0]:
            depth = flight_generator(world.seed, flight, Purpose.BATTERY).uniform(0.0, _SAG_START_DEPTH)
            self._charge_used_c = depth * values["battery"][4]
        self._com_frd = (*values["com_frd"], 0.0)
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
        }
        self.state[:] = pack(STATE, state)
        self._at = self._end = 0
        self.pose[:] = memoryview(array("d", [*p_ned, 0.0, 0.0, 0.0, *q_ned_frd]))
        self.sensed[:] = memoryview(array("d", [0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY_M_S2, self._full_v]))

    def step(self, motor_command: Sequence[float]) -> None:
        """Nothing comes back; one millisecond passes with the commands, 0..1 a rotor, held."""
        at = self._at
        if at == self._end and not self._calm:
            self._draw_noise()
            at = 0
        command = self._command
        command[0], command[1], command[2], command[3] = motor_command
        if not self._calm:
            self._at = after = at + 6
            self._noise[:] = self._block[at:after]
        self._state[:] = self.state
        self._engine()

    def _draw_noise(self) -> None:
        self._block = self._rng.standard_normal(6 * _NOISE_BLOCK).data
        self._end = 6 * _NOISE_BLOCK


@lru_cache(maxsize=1)
def _traced() -> Any:
    return sx_function(tick, INPUTS, OUTPUTS, "plant")


def plant_engine() -> CompiledEngine:
    """The plant's tick with memory of its own, compiled or not as `host.codegen` chooses."""
    return function_engine(_traced(), INPUTS, OUTPUTS)


def plant_parameters(vehicle: Vehicle, world: World) -> dict[str, list[float]]:
    """The plant's constants by the names of `plant_model.PARAMETERS`, from vehicle file and world.

    Where the centre of mass is off the origin, the battery has slid there: the inertia follows.
    """
    mass = vehicle.mass_kg * world.build_factor("mass", "factor")
    com = np.array([world.value("com-offset", "x"), world.value("com-offset", "y"), 0.0])
    inertia = np.diag(
        [
            j * world.build_factor("inertia", axis)
            for j, axis in zip(vehicle.inertia_kg_m2, "xyz", strict=True)
        ]
    )
    slide = mass * (1.0 / _BATTERY_SHARE - 1.0)
    inertia += slide * (com @ com * np.eye(3) - np.outer(com, com))
    lag = vehicle.motor_lag_s + world.value("motor-lag", "extra_s")
    uneven = _LAG_UNEVEN if "motor-lag" in world.effects else 0.0
    tether = world.effects.get("elastic-tether", {})
    stiffness = vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * _SINK_M)
    battery, turbulence = vehicle.battery, world.turbulence
    keep = math.exp(-TICK_S / turbulence.correlation_s)
    fresh = math.sqrt(1.0 - keep * keep)
    return {
        "mass_kg": [mass],
        "inertia": _four(inertia),
        "inertia_inverse": _four(np.linalg.inv(inertia)),
        "com_frd": com[:2].tolist(),
        "rotors_frd": [c for rotor in vehicle.rotors for c in rotor.position_m],
        "spins": [1.0 if rotor.spin == "ccw" else -1.0 for rotor in vehicle.rotors],
        "thrust_max_n": [vehicle.thrust_max_n],
        "thrust_curve": list(vehicle.thrust_curve),
        "torque_per_thrust_m": [vehicle.torque_per_thrust_m],
        "hover_speed": [math.sqrt(vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n))],
        "rise_half_tick": [math.exp(-0.5 * TICK_S / (lag * (1.0 - uneven)))],
        "fall_half_tick": [math.exp(-0.5 * TICK_S / (lag * (1.0 + uneven)))],
        "thrust_gain": [world.value("thrust-gain", "gain")],
        "linear_drag": [world.value("linear-drag", key) for key in ("dx", "dy", "dz")],
        "quadratic_drag": [world.value("quadratic-drag", "c")],
        "wind_ned": [world.value("wind", key) for key in ("wx", "wy")],
        "flapping": [world.value("blade-flapping", "moment")],
        "tether": [
            tether.get(key, 0.0)
            for key in ("stiffness", "damping", "slack_m", "anchor_x_m", "anchor_y_m", "anchor_z_m")
        ],
        "floor": [stiffness, 2.0 * _FLOOR_DAMPING * math.sqrt(stiffness * vehicle.mass_kg / 4.0)],
        "sag_exponent": [world.value("battery-sag", "exponent")],
        "battery": [
            1.0 if "battery-sag" in world.effects else 0.0,
            battery.full_v,
            battery.empty_v,
            battery.cells * _CELL_RESISTANCE_OHM_AH / battery.capacity_ah,
            battery.capacity_ah * 3600.0,
            _HOVER_POWER_W_PER_N * vehicle.mass_kg * GRAVITY_M_S2,
        ],
        "gust": [keep, fresh * turbulence.force_m_s2, fresh * turbulence.torque_rad_s2],
    }


def pack(layout: Sequence[Block], values: Mapping[str, Sequence[float]]) -> memoryview:
    """The numbers of `values` as one vector in the order of `layout`. Raises ValueError for a wrong size."""
    for name, size in layout:
        if len(values[name]) != size:
            raise ValueError(f"{name} holds {len(values[name])} numbers, not {size}")
    return memoryview(array("d", [float(number) for name, _ in layout for number in values[name]]))


def _four(tensor: np.ndarray) -> list[float]:
    return [float(tensor[i, k]) for i, k in ((0, 0), (1, 1), (2, 2), (0, 1))]
