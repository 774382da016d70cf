"""A whole simulated vehicle: body, sensors, flight and radio processors, ground radio and air, on one clock.

Every device has its own tick of a whole number of milliseconds; those that wait for bytes, slots or
exposures are only called when there are some. Nothing here reads a clock: the same seeds give the same
bytes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import lru_cache
from math import cos, sin
from pathlib import Path
from time import thread_time_ns
from typing import Any, Self

from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.mcu.flight_mcu import FlightMcu, flight_uart
from trimtab.firmware_model.mcu.radio_mcu import RadioMcu
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.codegen import function_engine, sx_function
from trimtab.host.vehicle import ConfigurationError, Vehicle, to_parameters
from trimtab.host.vehicle.strict_toml import validate
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import CAMERAS, HOST_RADIO, VEHICLE_RADIO, AttPosMocap
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.draw import World, draw_world
from trimtab.sitl.foreign import ForeignPlant, load_foreign_plant, read_plant_options
from trimtab.sitl.memory import open_memory
from trimtab.sitl.plant import Plant
from trimtab.sitl.radio import RadioChannel
from trimtab.sitl.seeds import Purpose, flight_generator, session_uid
from trimtab.sitl.sensors import Imu, Mocap
from trimtab.sitl.serve import ServeStatistics, serve
from trimtab.sitl.timing import TickTimes
from trimtab.sitl.truth import truth_record
from trimtab.sitl.world import RadioSettings, load_world

HOST_RX_BYTES = 65_536
HOST_TX_BYTES = 65_536
TWO_POSES_HZ = 200
"""From this rate on two poses may share a frame."""
DEFAULT_WORLD = "empty"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setting:
    """What a simulated vehicle is made from; `radio` overrides the world's radio settings by key."""

    vehicle: Vehicle
    world: World
    plant: str | None
    plant_options: Mapping[str, Any]
    start_ned: tuple[float, float, float]
    start_yaw: float


class SimulatedVehicle:
    """A vehicle flown over a serial port and a camera system, in lock-step. Satisfies host.link.Vehicle.

    Made by `create`. `now_us` is the time since power-up; `store` the memory on board that outlives it.
    """

    def __init__(self, setting: Setting, flight: int, store: ReferenceStore) -> None:
        self._setting = setting
        self.store = store
        self._parameters: Mapping[str, float] = to_parameters(setting.vehicle)
        self._timers: dict[str, int] | None = None
        self._power_up(flight)

    @classmethod
    def create(  # noqa: PLR0913 (one keyword for each choice)
        cls,
        vehicle: Vehicle,
        *,
        world: str | None = None,
        world_seed: int = 0,
        flight: int = 0,
        plant: str | None = None,
        plant_options: str | None = None,
        start_ned: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_yaw: float = 0.0,
        radio: Mapping[str, Any] | None = None,
        memory: Path | None = None,
    ) -> Self:
        """Return a vehicle in a world, powered up for a flight.

        Parameters
        ----------
        vehicle
            the vehicle file. world: name or path of a world, `empty` where not given.
        world_seed, flight
            seeds, not negative; the world comes from the first alone.
        plant
            a foreign plant in place of a world, as path.py:Class. plant_options: path of its TOML.
        start_ned, start_yaw
            where it stands, m and rad; z 0 is the floor.
        radio
            settings that override the world's, by the keys of its `[radio]` table.
        memory
            file of the memory that outlives power cuts; it lasts as long as the object without.

        Raises ConfigurationError or ForeignPlantError (exit code 2).
        """
        if plant is not None and world is not None:
            raise ConfigurationError(["a foreign plant brings its own physics, leave out world or plant"])
        if plant is None and plant_options is not None:
            raise ConfigurationError(["plant options without a plant, name the plant as path.py:Class"])
        name, file = load_world(world if world is not None else DEFAULT_WORLD)
        drawn = draw_world(name, file, world_seed, vehicle)
        if radio:
            settings = validate({**drawn.radio.model_dump(), **radio}, "radio", RadioSettings)
            drawn = dataclasses.replace(drawn, radio=settings)
        setting = Setting(
            vehicle=vehicle,
            world=drawn,
            plant=plant,
            plant_options=read_plant_options(plant_options),
            start_ned=start_ned,
            start_yaw=start_yaw,
        )
        store = ReferenceStore() if memory is None else open_memory(memory, vehicle)
        try:
            return cls(setting, flight, store)
        except BaseException:
            store.flash.close()
            raise

    # What the host sees.

    def run_until(self, t_us: int) -> int:
        """Return the time now: `t_us` or, where bytes or poses wait for the host, earlier; at least a tick
        later.

        Raises ForeignPlantError where a foreign plant fails.
        """
        step, devices, command = self._step, self._devices, self._command
        port, camera = self._host_port, self._camera
        now_us = self.now_us
        try:
            while now_us < t_us:
                step(command)
                now_us += TICK_US
                devices(now_us)
                if now_us >= port.due_us or camera.ready:
                    break
        finally:
            self.now_us = now_us
        return now_us

    def serial_read(self) -> bytes:
        """Bytes that have arrived at the host's serial port since the last call."""
        return self._host_port.read(self.now_us) if self.now_us >= self._host_port.due_us else b""

    def serial_write(self, data: bytes) -> None:
        """Send bytes on the host's serial port, as far as its buffer holds them."""
        for start in range(0, len(data), HOST_TX_BYTES):
            self._host_port.write(data[start : start + HOST_TX_BYTES], self.now_us)

    def mocap_read(self) -> list[bytes]:
        """Datagrams of the camera system that have arrived since the last call, one a pose."""
        if not self._camera.ready:
            return []
        encode = self._camera_codec.encode
        return [
            encode(AttPosMocap(pose.stamp_us, list(pose.q_ned_frd), *pose.p_ned))
            for pose in self._camera.read()
        ]

    def power_cycle(self, flight: int) -> None:
        """Put the vehicle at its start at time 0, for another flight.

        Queues are empty and generators fresh; blobs and parameters on board are kept.
        """
        self.store = ReferenceStore(self.store.flash)
        self._power_up(flight)

    def close(self) -> None:
        """Close the memory's file, if any."""
        self.store.flash.close()

    def serve(
        self,
        *,
        port: str,
        stop: Callable[[], bool],
        mocap: str | None = None,
        realtime: bool = True,
        ready: Callable[[str], None] | None = None,
    ) -> ServeStatistics:
        """Statistics once `stop` turned true; see `trimtab.sitl.serve.serve`."""
        return serve(self, port=port, stop=stop, mocap=mocap, realtime=realtime, ready=ready)

    def truth(self) -> dict[str, Any]:
        """Return what the session hides: world, seed, drawn values, uid. For checks only."""
        plant = self._step_owner.name if isinstance(self._step_owner, ForeignPlant) else None
        return truth_record(self._setting.world, self._flight, plant=plant)

    def true_position(self) -> tuple[float, float, float]:
        """Where the vehicle really is, NED. For checks only."""
        x, y, z = self._pose[0:3]
        return x, y, z

    def radio_counts(self) -> dict[str, dict[str, int]]:
        """Return what happened to the frames in the air, by direction."""
        return {
            "up": dataclasses.asdict(self._channel.up),
            "down": dataclasses.asdict(self._channel.down),
        }

    def watch_air(self, told: Callable[[int, bytes], None]) -> None:
        """Call `told` for every frame that leaves a radio, until the next power cycle."""
        self._channel.watch = told

    # Inside.

    def _power_up(self, flight: int) -> None:
        setting, world = self._setting, self._setting.world
        seed = world.seed
        self._flight = flight
        self.now_us = 0
        self._step_owner: Plant | ForeignPlant = self._build_plant(flight)
        half = 0.5 * setting.start_yaw
        self._step_owner.reset(setting.start_ned, (cos(half), 0.0, 0.0, sin(half)))
        self._step = self._step_owner.step
        self._pose: Any = self._step_owner.pose
        self._sensed: Any = self._step_owner.sensed

        self._imu = Imu(world.imu, flight_generator(seed, flight, Purpose.IMU))
        self._imu_errors = self._imu.errors()
        latency_s, tilt = 0.0, (0.0, 0.0)
        if setting.plant is None:
            latency_s = world.value("mocap-latency", "latency_s")
            tilt = (world.value("frame-tilt", "tilt_x"), world.value("frame-tilt", "tilt_y"))
        mocap_rng = flight_generator(seed, flight, Purpose.MOCAP)
        self._camera = Mocap(world.mocap, latency_s, mocap_rng, tilt)
        self._camera_codec = Codec(*CAMERAS)

        self._timing = TickTimes(world.timing, flight_generator(seed, flight, Purpose.TIMING))
        serial = world.serial.model_dump()
        self._flight_mcu = FlightMcu(
            engine=function_engine(traced_law(), law.INPUTS, law.OUTPUTS),
            parameters=self._parameters,
            store=self.store,
            uid=session_uid(seed, flight),
            vehicle_id=setting.vehicle.id_bytes,
            uart=flight_uart(**serial),
            loop_times=self._timing.read,
        )
        self._command: Any = self._flight_mcu.motor_command
        self._flight_tick = self._flight_mcu.tick
        frame_bytes = world.radio.frame_bytes
        self._air_radio = RadioMcu(address=VEHICLE_RADIO, frame_bytes=frame_bytes, **serial)
        poses = 2 if world.mocap.rate_hz >= TWO_POSES_HZ else 1
        self._ground_radio = RadioMcu(address=HOST_RADIO, poses=poses, frame_bytes=frame_bytes, **serial)
        self._host_port = UartPort(baud=world.serial.baud, rx_bytes=HOST_RX_BYTES, tx_bytes=HOST_TX_BYTES)
        connect(self._flight_mcu.uart, self._air_radio.uart)
        connect(self._host_port, self._ground_radio.uart)
        self._channel = RadioChannel(
            ground=self._ground_radio,
            vehicle=self._air_radio,
            settings=world.radio,
            up_rng=flight_generator(seed, flight, Purpose.RADIO_UP),
            down_rng=flight_generator(seed, flight, Purpose.RADIO_DOWN),
        )
        if self._timers is not None:
            self.start_profile()
        self._devices(0)

    def _build_plant(self, flight: int) -> Plant | ForeignPlant:
        setting = self._setting
        if setting.plant is None:
            return Plant(setting.vehicle, setting.world, flight)
        seed = int(flight_generator(setting.world.seed, flight, Purpose.FOREIGN_PLANT).integers(2**62))
        return load_foreign_plant(setting.plant, setting.vehicle, setting.plant_options, seed)

    def _devices(self, now_us: int) -> None:
        """Everything but the body, at one instant: camera, radios, then the flight processor."""
        camera, channel = self._camera, self._channel
        if now_us >= camera.due_us:
            camera.tick(now_us, self._pose, self._sensed[0:3])
        ground, air = self._ground_radio, self._air_radio
        if now_us >= channel.due_us:
            channel.tick(now_us)
        # `due_us` of the radios, written out: it is asked for twice a tick.
        if (now_us >= ground.radio_due_us or now_us >= ground.uart.due_us) and ground.tick(now_us):
            channel.wake(now_us, ground=True)
        if (now_us >= air.radio_due_us or now_us >= air.uart.due_us) and air.tick(now_us):
            channel.wake(now_us, ground=False)
        p, q, r, x, y, z, volts = self._sensed
        dp, dq, dr, dx, dy, dz, dv = next(self._imu_errors)
        timing = self._timing
        if now_us >= timing.due_us and timing.missed(now_us):
            return  # still busy with an earlier tick: the rotors keep their command
        self._flight_tick(now_us, (p + dp, q + dq, r + dr), (x + dx, y + dy, z + dz), volts + dv)

    # Measuring where the time goes.

    def start_profile(self) -> None:
        """Start to measure the time of each part in `profile`, also over power cycles."""
        timers = self._timers = self._timers or {}
        self._step = _timed(self._step_owner.step, "plant", timers)
        self._flight_tick = _timed(self._flight_mcu.tick, "flight processor", timers)
        for device, part in (
            (self._camera, "camera"),
            (self._channel, "channel"),
            (self._ground_radio, "ground radio"),
            (self._air_radio, "vehicle radio"),
        ):
            device.tick = _timed(type(device).tick.__get__(device), part, timers)

    def profile(self) -> dict[str, float]:
        """Seconds spent in each part since `start_profile`; empty without it."""
        return {part: 1e-9 * spent for part, spent in (self._timers or {}).items()}


@lru_cache(maxsize=1)
def traced_law() -> Any:
    """Return the law as a symbolic function, traced once for all vehicles of the process."""
    return sx_function(law.step, law.INPUTS, law.OUTPUTS, "flight")


def _timed(function: Callable[..., Any], part: str, timers: dict[str, int]) -> Callable[..., Any]:
    """Return the function, with the time of each call added to `timers[part]`."""
    timers.setdefault(part, 0)

    def timed(*arguments: Any) -> Any:
        begin = thread_time_ns()
        try:
            return function(*arguments)
        finally:
            timers[part] += thread_time_ns() - begin

    return timed
