"""The plant: a compiled tick of the simulated physics with the constants of one world and one flight."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from struct import Struct
from typing import Any, Protocol

from trimtab.host.codegen import CompiledEngine, function_engine, sx_function
from trimtab.host.vehicle import Vehicle
from trimtab.sitl.carried import START_DEPTH, payload_at_rest
from trimtab.sitl.draw import World
from trimtab.sitl.gusts import Gusts
from trimtab.sitl.plant_constants import SINK_M, plant_parameters
from trimtab.sitl.plant_model import INPUTS, OUTPUTS, PARAMETERS, PARTS, STATE, TICK_S, Block, tick
from trimtab.sitl.seeds import Purpose, flight_generator
from trimtab.sitl.surroundings import GRAVITY_M_S2
from trimtab.sitl.vectors import rotation

_NOISE_BLOCK = 1024
_SPEEDS = slice(13, 17)
_COMMANDS_MAX = 4096  # numbers that are kept before all but the latest are dropped
_write_eight = Struct("8d").pack_into
_ENGINE_INPUTS = (
    *(block for block in INPUTS if block.name != "command"),
    Block("commands", 8),  # of the four motors in the tick after their delay, then of the tick before it
    Block("delay_parts", 4),  # place of each motor's delay between the two ticks
)
_DELAY_SPREAD = (0.05, -0.03, -0.05, 0.03)  # relative spread of the motor controllers' delays


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


class Plant:
    """A vehicle in a world, stepped in milliseconds. Satisfies PlantPort.

    `state` holds `plant_model.STATE` after the last step. Call `reset` first.
    """

    def __init__(self, vehicle: Vehicle, world: World, flight: int) -> None:
        discharges = {"battery-sag"} if world.battery.discharges else set[str]()
        parts = PARTS.intersection({*world.effects, *discharges})
        self._engine = plant_engine(parts)
        self._run = self._engine.run
        inputs: Any = self._engine.inputs
        outputs: Any = self._engine.outputs
        self._state, self._commands, self._noise = inputs["state"], inputs["commands"], inputs["noise"]
        self.state = outputs["state"]
        self.pose = outputs["pose"]
        self.sensed = outputs["sensed"]
        values = plant_parameters(vehicle, world)
        inputs["parameters"][:] = pack(PARAMETERS, values)
        self._full_v = values["battery"][0]
        self._calm = world.turbulence.force_m_s2 == 0.0 and world.turbulence.torque_rad_s2 == 0.0
        self._gusts = Gusts(world.turbulence, flight_generator(world.seed, flight, Purpose.TURBULENCE))
        self._charge_used_c = 0.0
        if "battery-sag" in parts:
            depth = flight_generator(world.seed, flight, Purpose.BATTERY).uniform(0.0, START_DEPTH)
            self._charge_used_c = depth * values["battery"][3]
        self._phases = flight_generator(world.seed, flight, Purpose.PHASES).random(2).tolist()
        self._com_frd = values["com_frd"]
        self._line_m = values["payload"][1]
        delays = [world.value("actuation-delay", "delay_s") / TICK_S * (1.0 + e) for e in _DELAY_SPREAD]
        ticks = [int(delay) for delay in delays]
        inputs["delay_parts"][:] = pack(
            (_ENGINE_INPUTS[-1],), {"delay_parts": [d - t for d, t in zip(delays, ticks, strict=True)]}
        )
        self._sent_size = 4 * (max(ticks) + 2)
        self._sent: list[float] = []  # the commands of past ticks, the latest last
        latest = [-4 * (t + 1) + i for i, t in enumerate(ticks)]
        self._delayed = itemgetter(*latest, *(at - 4 for at in latest))
        self._block = memoryview(b"")
        self._at = self._end = 0

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Put the vehicle at rest at a pose, with rotors stopped and turbulence in its stationary state.

        At z_ned = 0 the feet stand on the floor.
        """
        R, com = rotation(q_ned_frd), self._com_frd
        p = [p_ned[i] + sum(R[3 * i + k] * com[k] for k in range(3)) for i in range(3)]
        if p_ned[2] == 0.0:
            p[2] += SINK_M
        state = {
            "p_ned": p,
            "v_ned": [0.0] * 3,
            "q_ned_frd": q_ned_frd,
            "rate_frd": [0.0] * 3,
            "rotor_speed": [0.0] * 4,
            "charge_used_c": [self._charge_used_c],
            "gust": self._gusts.start(),
            "acceleration_ned": [0.0] * 3,
            "turning_frd": [0.0] * 3,
            "payload_ned": [*payload_at_rest(p_ned, self._line_m), 0.0, 0.0, 0.0],
            "slide": [0.0, 0.0],
            "clock": [0.0, *self._phases],
        }
        self.state[:] = pack(STATE, state)
        self._at = self._end = 0
        self._sent = [0.0] * self._sent_size
        self.pose[:] = memoryview(array("d", [*p_ned, 0.0, 0.0, 0.0, *q_ned_frd]))
        self.sensed[:] = memoryview(array("d", [0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY_M_S2, self._full_v]))

    def step(self, motor_command: Sequence[float]) -> None:
        """Advance by one millisecond with constant motor commands in 0..1."""
        sent, delayed, run = self._sent, self._delayed, self._run  # a local is called faster than a field
        sent += motor_command
        if len(sent) > _COMMANDS_MAX:
            del sent[: -self._sent_size]
        _write_eight(self._commands, 0, *delayed(sent))
        if not self._calm:
            if self._at == self._end:
                self._draw_noise()
            at = self._at
            self._at = after = at + 6
            self._noise[:] = self._block[at:after]
        self._state[:] = self.state
        run()

    def rotor_speeds(self) -> list[float]:
        """Return the speeds of the rotors (4,), over that at the greatest thrust."""
        return self.state[_SPEEDS].tolist()

    def _draw_noise(self) -> None:
        self._block = self._gusts.noise(_NOISE_BLOCK).ravel().data
        self._at, self._end = 0, 6 * _NOISE_BLOCK


@lru_cache(maxsize=32)
def _traced(parts: frozenset[str]) -> Any:
    return sx_function(partial(_delayed_tick, parts=parts), _ENGINE_INPUTS, OUTPUTS, "plant")


def _delayed_tick(ops: Any, inputs: Mapping[str, Any], parts: frozenset[str]) -> dict[str, list[Any]]:
    """Return a tick under the commands that arrive at the motors, interpolated between two ticks."""
    later, earlier = inputs["commands"][:4], inputs["commands"][4:]
    between = zip(later, earlier, inputs["delay_parts"], strict=True)
    command = [new + part * (old - new) for new, old, part in between]
    return tick(ops, {**inputs, "command": command}, parts)


def plant_engine(parts: frozenset[str] = PARTS) -> CompiledEngine:
    """Return an engine for the tick with these parts of `plant_model.PARTS`, with its own memory.

    Instead of the block `command` it has `commands` and `delay_parts`.

    `trimtab.host.codegen` decides whether it is compiled.
    """
    return function_engine(_traced(parts), _ENGINE_INPUTS, OUTPUTS)


def pack(layout: Sequence[Block], values: Mapping[str, Sequence[float]]) -> memoryview:
    """Return `values` as one vector in the order of `layout`. Raises ValueError for a wrong size."""
    for name, size in layout:
        if len(values[name]) != size:
            raise ValueError(f"{name} holds {len(values[name])} numbers, not {size}")
    return memoryview(array("d", [float(number) for name, _ in layout for number in values[name]]))
