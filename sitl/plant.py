"""The plant: a compiled tick of the simulated physics with the constants of one world and one flight."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple, Protocol

from trimtab.host.codegen import CompiledEngine, address, function_engine, sx_function
from trimtab.host.vehicle import Vehicle
from trimtab.sitl.draw import World
from trimtab.sitl.plant_constants import SINK_M, plant_parameters
from trimtab.sitl.plant_model import INPUTS, OUTPUTS, PARAMETERS, PARTS, STATE, TICK_S, Block, tick
from trimtab.sitl.seeds import Purpose, flight_generator
from trimtab.sitl.surroundings import GRAVITY_M_S2, LINE_STRETCH_M
from trimtab.sitl.vectors import rotation

_SAG_START_DEPTH = 0.4  # greatest depth of discharge at the start of a flight in a world with battery-sag
_NOISE_BLOCK = 1024
NOISE = 6
"""Numbers of turbulence that a tick takes."""
_DELAY_SPREAD = (0.05, -0.03, -0.05, 0.03)  # relative spread of the motor controllers' delays
_LYING_AT_M = (-0.12, 0.05)  # north and east offset of a payload on the floor from the vehicle


class PlantPort(Protocol):
    """Interface of a plant, the simulator's own or a foreign one.

    `pose` holds p_ned and v_ned of the origin and q_ned_frd (w first). `sensed` holds body rate and specific
    force in FRD and the battery voltage. Both are arrays of doubles that every step overwrites in place.
    """

    @property
    def pose(self) -> Any: ...
    @property
    def sensed(self) -> Any: ...

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None: ...
    def step(self, motor_command: Sequence[float]) -> None: ...


class Delay(NamedTuple):
    """Past commands, and which two of them each motor follows.

    sent: four commands a tick, newest tick first; empty without a delay. motors: for each motor its number,
    the two indices in `sent` around its delay, and the fraction of a tick between them.
    """

    sent: memoryview
    motors: tuple[tuple[int, int, int, float], ...]

    @classmethod
    def of(cls, ticks: Sequence[float]) -> Delay:
        """Return the delay of each motor, in ticks."""
        size = 4 * (int(max(ticks)) + 2) if max(ticks) > 0.0 else 0
        motors = tuple(
            (i, 4 * int(delay) + i, 4 * int(delay) + 4 + i, delay - int(delay))
            for i, delay in enumerate(ticks)
        )
        return cls(memoryview(array("d", bytes(8 * size))), motors)


class Plant:
    """A vehicle in a world, stepped in milliseconds. Satisfies PlantPort.

    `state` holds `plant_model.STATE` after the last step. Call `reset` first.
    """

    def __init__(self, vehicle: Vehicle, world: World, flight: int) -> None:
        self.function = _traced(PARTS.intersection(world.effects))
        self.engine = function_engine(self.function, INPUTS, OUTPUTS)
        inputs: Any = self.engine.inputs
        outputs: Any = self.engine.outputs
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
        ticks = [world.value("actuation-delay", "delay_s") / TICK_S * (1.0 + e) for e in _DELAY_SPREAD]
        self.delay = Delay.of(ticks)
        self._gust_sd = (world.turbulence.force_m_s2, world.turbulence.torque_rad_s2)
        self._block = memoryview(array("d"))
        self._at = self._block_address = 0

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Put the vehicle at rest at a pose, with rotors stopped and turbulence in its stationary state.

        At z_ned = 0 the feet stand on the floor.
        """
        R, com = rotation(q_ned_frd), self._com_frd
        p = [p_ned[i] + sum(R[3 * i + k] * com[k] for k in range(3)) for i in range(3)]
        if p_ned[2] == 0.0:
            p[2] += SINK_M
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
        self._block, self._at = memoryview(array("d")), 0
        self.delay.sent[:] = memoryview(array("d", bytes(self.delay.sent.nbytes)))
        self.pose[:] = memoryview(array("d", [*p_ned, 0.0, 0.0, 0.0, *q_ned_frd]))
        self.sensed[:] = memoryview(array("d", [0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY_M_S2, self._full_v]))

    def step(self, motor_command: Sequence[float]) -> None:
        """Advance by one millisecond with constant motor commands in 0..1."""
        command, delay = self._command, self.delay
        if delay.sent:
            sent = delay.sent
            sent[4:] = sent[:-4]
            sent[0], sent[1], sent[2], sent[3] = motor_command
            for i, later, earlier, part in delay.motors:
                newer = sent[later]
                command[i] = newer + part * (sent[earlier] - newer)
        else:
            command[0], command[1], command[2], command[3] = motor_command
        if not self._calm:
            if self._at == len(self._block):
                self.noise_left()
            at, self._at = self._at, self._at + NOISE
            self._noise[:] = self._block[at : self._at]
        self._state[:] = self.state
        self.engine()

    def noise_left(self) -> int:
        """Return for how many ticks noise has been drawn, at least one."""
        if self._calm:
            return _NOISE_BLOCK
        if self._at == len(self._block):
            self._block, self._at = self._rng.standard_normal(NOISE * _NOISE_BLOCK).data, 0
            self._block_address = address(self._block)
        return (len(self._block) - self._at) // NOISE

    def take_noise(self, count: int) -> int | None:
        """Return the address of the noise of the next ticks, at most `noise_left`; None in calm air."""
        if self._calm:
            return None
        at, self._at = self._at, self._at + NOISE * count
        return self._block_address + at * self._block.itemsize

    def _hanging(self, p_ned: Sequence[float]) -> list[float]:
        """Return the initial position of a payload: under the vehicle, or on the floor beside it."""
        x, y, z = p_ned
        if z + self._line_m < 0.0:
            return [x, y, z + self._line_m + LINE_STRETCH_M]
        return [x + _LYING_AT_M[0], y + _LYING_AT_M[1], 0.0]


@lru_cache(maxsize=32)
def _traced(parts: frozenset[str]) -> Any:
    return sx_function(partial(tick, parts=parts), INPUTS, OUTPUTS, "plant")


def plant_engine(parts: frozenset[str] = PARTS) -> CompiledEngine:
    """Return an engine for the tick with these parts of `plant_model.PARTS`, with its own memory.

    `trimtab.host.codegen` decides whether it is compiled.
    """
    return function_engine(_traced(parts), INPUTS, OUTPUTS)


def pack(layout: Sequence[Block], values: Mapping[str, Sequence[float]]) -> memoryview:
    """Return `values` as one vector in the order of `layout`. Raises ValueError for a wrong size."""
    for name, size in layout:
        if len(values[name]) != size:
            raise ValueError(f"{name} holds {len(values[name])} numbers, not {size}")
    return memoryview(array("d", [float(number) for name, _ in layout for number in values[name]]))
