"""A complete simulated vehicle: plant, sensors, flight and radio processors, ground radio and channel.

Every device ticks on one clock in whole milliseconds. A device that waits for bytes, slots or exposures is
called only when it has work. Nothing here reads a real clock: the same seeds give the same bytes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from operator import add
from pathlib import Path
from time import thread_time_ns
from typing import Any, Self

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.verdict import check_blob
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.mcu.flight_mcu import FlightMcu, flight_uart
from trimtab.firmware_model.mcu.radio_mcu import RadioMcu
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.codegen import function_engine, sx_function
from trimtab.host.codegen.all_at_once import ALL_AT_ONCE
from trimtab.host.vehicle import ConfigurationError, Vehicle, to_parameters
from trimtab.host.vehicle.strict_toml import validate
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import CAMERAS, HOST_RADIO, SIMULATED_BOARD, VEHICLE_RADIO, AttPosMocap
from trimtab.protocol.parameters import BY_NAME
from trimtab.protocol.signing import SIMULATED_EPOCH, SigningKey
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.camera_faults import CameraFaults
from trimtab.sitl.draw import draw_world
from trimtab.sitl.foreign import ForeignPlant, load_foreign_plant, read_plant_options
from trimtab.sitl.memory import open_memory
from trimtab.sitl.plant import Plant
from trimtab.sitl.radio import RadioChannel
from trimtab.sitl.seeds import Purpose, flight_generator, session_uid
from trimtab.sitl.sensors import Imu, Mocap, RotorSpeedSensor
from trimtab.sitl.serve import ServeStatistics, serve
from trimtab.sitl.setting import Place, Setting
from trimtab.sitl.stand_in import StandIn
from trimtab.sitl.timing import TickTimes
from trimtab.sitl.truth import truth_record
from trimtab.sitl.world import RadioSettings, load_world

HOST_RX_BYTES = 65_536
HOST_TX_BYTES = 65_536
HOST_WAITING_BYTES = 512
"""Bytes on the host's serial line above which no more are let in, 5.6 ms."""
TWO_POSES_HZ = 200
"""Pose rate from which two poses may share a frame."""
DEFAULT_WORLD = "empty"


class SimulatedVehicle:
    """A vehicle with a serial port and a camera system, in lock-step. Satisfies host.link.Vehicle.

    Use `create` to make one. `now_us` is the time since `create` or `power_cycle`, which a reboot does not
    restart. `store` is the non-volatile memory on board.
    """

    def __init__(self, setting: Setting, flight: int, store: ReferenceStore) -> None:
        self._setting = setting
        self.store = store
        self._parameters: Mapping[str, float] = to_parameters(setting.vehicle)
        self._timers: dict[str, int] | None = None
        self._power_up(flight, setting.start)

    @classmethod
    def create(  # noqa: PLR0913 (one keyword for each option)
        cls,
        vehicle: Vehicle,
        *,
        world: str | None = None,
        world_seed: int = 0,
        flight: int = 0,
        plant: str | None = None,
        plant_options: str | None = None,
        plant_trusted: bool = False,
        start_ned: tuple[float, float, float] = (0.0, 0.0, 0.0),
        start_yaw: float = 0.0,
        radio: Mapping[str, Any] | None = None,
        memory: Path | None = None,
        key: SigningKey | None = None,
        at_port: bool = False,
    ) -> Self:
        """Return a vehicle in a world, powered up for a flight.

        Parameters
        ----------
        vehicle
            Content of the vehicle file.
        world
            Name or path of a world. Default: `empty`.
        world_seed, flight
            Non-negative seed and flight index. The world depends on the seed alone.
        plant
            Foreign plant, path.py:Class. With `world`, it gets that world.
        plant_options
            Path of the TOML file for the foreign plant.
        plant_trusted
            Whether the plant's code may run although others can change its file.
        start_ned, start_yaw
            Initial position, m, and yaw, rad. The floor is at z = 0.
        radio
            Settings that override the world's, by the keys of its `[radio]` table.
        memory
            File of the non-volatile memory. Without it, the memory lasts as long as the object.
        key
            Key of message signing, installed before the first power-up.
        at_port
            Whether the vehicle will be served at a port. Its session then has another uid.

        Raises ConfigurationError or ForeignPlantError (exit code 2).
        """
        if plant is None and plant_options is not None:
            raise ConfigurationError(["plant options without a plant; name the plant as path.py:Class"])
        name, file = load_world(world if world is not None else DEFAULT_WORLD)
        drawn = draw_world(name, file, world_seed, vehicle)
        if radio:
            settings = validate({**drawn.radio.model_dump(), **radio}, "radio", RadioSettings)
            drawn = dataclasses.replace(drawn, radio=settings)
        setting = Setting(
            vehicle=vehicle,
            world=drawn,
            is_world_named=world is not None,
            plant=plant,
            plant_options=read_plant_options(plant_options),
            plant_trusted=plant_trusted,
            start=Place(start_ned, start_yaw),
            at_port=at_port,
        )
        store = ReferenceStore() if memory is None else open_memory(memory, vehicle)
        if key is not None:
            store.signing.keep(key, SIMULATED_EPOCH - 1)
        try:
            return cls(setting, flight, store)
        except BaseException:
            store.flash.close()
            raise

    # Interface to the host.

    def run_until(self, t_us: int) -> int:
        """Run until `t_us`, or until bytes or poses wait for the host, and return the time reached.

        Runs at least one tick if `t_us` lies ahead. Raises ForeignPlantError if a foreign plant fails.
        """
        step, devices, command = self._step, self._tick_devices, self._command
        port, camera = self._host_port, self._camera
        now_us = self.now_us - self._booted_us
        t_us -= self._booted_us
        try:
            while now_us < t_us:
                step(command)
                now_us += TICK_US
                devices(now_us)
                if now_us >= port.due_us or camera.ready:
                    break
        finally:
            self.now_us = self._booted_us + now_us
        if now_us >= self._flight_mcu.reboot_us:
            self._reboot()
        return self.now_us

    def serial_read(self) -> bytes:
        """Return the bytes that have arrived at the host's serial port since the last call."""
        now_us = self.now_us - self._booted_us
        return self._host_port.read(now_us) if now_us >= self._host_port.due_us else b""

    def serial_write(self, data: bytes) -> None:
        """Send bytes on the host's serial port; bytes that do not fit its buffer are lost."""
        for start in range(0, len(data), HOST_TX_BYTES):
            self._host_port.write(data[start : start + HOST_TX_BYTES], self.now_us - self._booted_us)

    def serial_room(self) -> int:
        """Return how many bytes to write at most, so that no more than HOST_WAITING_BYTES wait."""
        waiting = HOST_TX_BYTES - self._host_port.tx_free(self.now_us - self._booted_us)
        return max(0, HOST_WAITING_BYTES - waiting)

    def mocap_read(self) -> list[bytes]:
        """Return the camera system's datagrams since the last call, one for each pose."""
        if not self._camera.ready:
            return []
        encode, booted_us = self._camera_codec.encode, self._booted_us
        return [
            encode(AttPosMocap(booted_us + pose.stamp_us, list(pose.q_ned_frd), *pose.p_ned))
            for pose in self._camera.read()
        ]

    def power_cycle(self, flight: int) -> None:
        """Restart the vehicle at its initial position at time 0, for another flight.

        Queues are emptied and generators restarted. Blobs and parameters on board are kept.
        """
        self.store = ReferenceStore(self.store.flash)
        self._power_up(flight, self._setting.start)

    def close(self) -> None:
        """Close the file of the memory, if there is one."""
        self.store.flash.close()

    def serve(
        self,
        *,
        port: str,
        stop: Callable[[], bool],
        mocap: str | None = None,
        realtime: bool = True,
        ready: Callable[[str], None] | None = None,
        on_late: Callable[[str], None] | None = None,
    ) -> ServeStatistics:
        """Run in real time at a port until `stop` returns True; see `trimtab.sitl.serve.serve`."""
        return serve(self, port=port, stop=stop, mocap=mocap, realtime=realtime, ready=ready, on_late=on_late)

    @property
    def clock_us(self) -> int:
        """Time on the clock of the flight processor, which a reboot restarts, us."""
        return self.now_us - self._booted_us

    def as_autopilot(self, make: str) -> StandIn:
        """Return this vehicle, powered up anew, with a port that speaks as another autopilot.

        make: "px4" or "ardupilot". It limits the acceleration of setpoints to what its greatest tilt
        gives, not to OFFB_ACCEL.
        """
        accel = GRAVITY * math.tan(math.radians(self._setting.vehicle.limits.tilt_max_deg))
        self._parameters = {**self._parameters, "OFFB_ACCEL": min(accel, BY_NAME["OFFB_ACCEL"].max)}
        self._power_up(self._flight, self._setting.start)
        return StandIn(self, make)

    def truth(self) -> dict[str, Any]:
        """Return the sealed truth: world, seed, drawn values, uid. For checks only."""
        plant = self._step_owner.name if isinstance(self._step_owner, ForeignPlant) else None
        setting = self._setting
        return truth_record(setting.world, self._flight, plant=plant, at_port=setting.at_port)

    def true_position(self) -> tuple[float, float, float]:
        """Return the true position, NED. For checks only."""
        return self.true_motion()[0]

    def true_motion(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the true position and velocity, NED. For checks only."""
        x, y, z, vx, vy, vz = self._pose[0:6]
        return (x, y, z), (vx, vy, vz)

    @property
    def flight(self) -> Flight:
        """Flight logic on board. For checks only."""
        return self._flight_mcu.flight

    @property
    def motor_command(self) -> tuple[float, ...]:
        """Motor commands of the last tick, four numbers in 0..1. For checks only."""
        return tuple(self._command)

    def radio_counts(self) -> dict[str, dict[str, int]]:
        """Return the channel's frame counters by direction."""
        return {
            "up": dataclasses.asdict(self._channel.up),
            "down": dataclasses.asdict(self._channel.down),
        }

    def watch_air(self, on_frame: Callable[[int, bytes], None]) -> None:
        """Call `on_frame` with time and bytes of every frame sent, until the next power cycle."""
        self._channel.watch = on_frame

    # Internals.

    def _reboot(self) -> None:
        """Restart all devices except the cameras' clock, with a full battery, and right a crashed vehicle."""
        self.store = ReferenceStore(self.store.flash)
        self._power_up(self._flight, self._setting.place_after_reboot(self._pose), self.now_us)

    def _power_up(self, flight: int, place: Place, now_us: int = 0) -> None:
        setting, world = self._setting, self._setting.world
        seed = world.seed
        self._flight = flight
        self.now_us = self._booted_us = now_us  # all devices count from here
        self._step_owner: Plant | ForeignPlant = self._build_plant(flight)
        self._step_owner.reset(place.p_ned, place.q_ned_frd)
        self._step = self._step_owner.step
        self._pose: Any = self._step_owner.pose
        self._sensed: Any = self._step_owner.sensed

        self._imu = Imu(world.imu, flight_generator(seed, flight, Purpose.IMU))
        self._imu_errors = self._imu.errors()
        latency_s, tilt, faults = 0.0, (0.0, 0.0), None
        if setting.plant is None or setting.is_world_named:
            latency_s = world.value("mocap-latency", "latency_s")
            tilt = (world.value("frame-tilt", "tilt_x"), world.value("frame-tilt", "tilt_y"))
            faults = CameraFaults.of(world)
        mocap_rng = flight_generator(seed, flight, Purpose.MOCAP)
        self._camera = Mocap(world.mocap, latency_s, mocap_rng, tilt, faults)
        self._camera_codec = Codec(*CAMERAS)

        rotor_speed = None
        if setting.vehicle.measures_rotor_speed and isinstance(self._step_owner, Plant):
            rng = flight_generator(seed, flight, Purpose.ROTOR_SPEED)
            rotor_speed = RotorSpeedSensor(self._step_owner.rotor_speeds, rng).read
        self._timing = TickTimes(world.timing, flight_generator(seed, flight, Purpose.TIMING))
        serial = world.serial.model_dump()
        self._flight_mcu = FlightMcu(
            engine=function_engine(traced_law(), law.INPUTS, law.OUTPUTS),
            parameters=self._parameters,
            store=self.store,
            uid=session_uid(seed, flight, at_port=setting.at_port),
            vehicle_id=setting.vehicle.id_bytes,
            board_version=SIMULATED_BOARD,
            uart=flight_uart(wired=world.radio.wired, **serial),
            loop_times=self._timing.read,
            check=partial(check_blob, evaluator=ALL_AT_ONCE),
            rotor_speed=rotor_speed,
        )
        self._command: Any = self._flight_mcu.motor_command
        self._flight_tick = self._flight_mcu.tick
        frame_bytes = world.radio.frame_bytes
        self._air_radio = RadioMcu(address=VEHICLE_RADIO, frame_bytes=frame_bytes, **serial)
        poses = 2 if world.mocap.rate_hz >= TWO_POSES_HZ else 1
        self._ground_radio = RadioMcu(address=HOST_RADIO, poses=poses, frame_bytes=frame_bytes, **serial)
        self._host_port = UartPort(baud=world.serial.baud, rx_bytes=HOST_RX_BYTES, tx_bytes=HOST_TX_BYTES)
        self._wired = world.radio.wired
        if self._wired:
            connect(self._host_port, self._flight_mcu.uart)
        else:
            connect(self._flight_mcu.uart, self._air_radio.uart)
            connect(self._host_port, self._ground_radio.uart)
        self._channel = RadioChannel(
            ground=self._ground_radio,
            vehicle=self._air_radio,
            settings=world.radio,
            up_rng=flight_generator(seed, flight, Purpose.RADIO_UP),
            down_rng=flight_generator(seed, flight, Purpose.RADIO_DOWN),
        )
        self._tick_devices = self._devices()
        if self._timers is not None:
            self.start_profile()
        self._tick_devices(0)

    def _build_plant(self, flight: int) -> Plant | ForeignPlant:
        setting = self._setting
        if setting.plant is None:
            return Plant(setting.vehicle, setting.world, flight)
        seed = int(flight_generator(setting.world.seed, flight, Purpose.FOREIGN_PLANT).integers(2**62))
        world = setting.world if setting.is_world_named else None
        return load_foreign_plant(
            setting.plant,
            setting.vehicle,
            setting.plant_options,
            seed,
            world,
            trusted=setting.plant_trusted,
        )

    def _devices(self) -> Callable[[int], None]:
        """Return the function that ticks all devices except the plant: camera, radios, flight processor."""
        camera, channel, ground, air = self._camera, self._channel, self._ground_radio, self._air_radio
        ground_uart, air_uart = ground.uart, air.uart
        wired, pose, sensed = self._wired, self._pose, self._sensed
        next_errors, timing, flight_tick = self._imu_errors.__next__, self._timing, self._flight_tick

        def tick(now_us: int) -> None:
            if now_us >= camera.due_us:
                camera.tick(now_us, pose, sensed[0:3])
            if not wired:
                if now_us >= channel.due_us:
                    channel.tick(now_us)
                # `due_us` of the radios, inlined for speed.
                if (now_us >= ground.radio_due_us or now_us >= ground_uart.due_us) and ground.tick(now_us):
                    channel.wake(now_us, ground=True)
                if (now_us >= air.radio_due_us or now_us >= air_uart.due_us) and air.tick(now_us):
                    channel.wake(now_us, ground=False)
            p, q, r, x, y, z, volts = map(add, sensed, next_errors())
            if now_us >= timing.due_us and timing.missed(now_us):
                return  # still busy with an earlier tick; the motor command stays the same
            flight_tick(now_us, (p, q, r), (x, y, z), volts)

        return tick

    # Profiling.

    def start_profile(self) -> None:
        """Start to measure the time spent in each part. Power cycles do not stop this."""
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
        self._tick_devices = self._devices()

    def profile(self) -> dict[str, float]:
        """Return the seconds spent in each part since `start_profile`; empty without it."""
        return {part: 1e-9 * spent for part, spent in (self._timers or {}).items()}


@lru_cache(maxsize=1)
def traced_law() -> Any:
    """Return the control law as a symbolic function, traced once for all vehicles of the process."""
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
