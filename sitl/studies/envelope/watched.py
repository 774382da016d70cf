"""A simulated vehicle under a station, wired, in lock-step, with its true motion recorded.

The station speaks MAVLink over the serial line, as any client would. What is recorded is the plant's own
state, so a fault of the estimate hides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from trimtab.firmware_model.flight.invariants import CONTACT_M, Moment, above_ceiling, past_walls
from trimtab.firmware_model.flight.supervisor import State
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, Message, mavlink
from trimtab.sitl.vehicle import SimulatedVehicle

STEP_US = 10_000
"""Interval of the samples."""
LINK_US = 500_000
"""Interval at which a station shows that it is alive."""
_POSITION = 0b0000_0111  # bits of type_mask that mask the position out
_ACCELERATION, _YAW, _YAW_RATE = 0b1_1100_0000, 1 << 10, 1 << 11


@dataclass(frozen=True, kw_only=True)
class Sample:
    """True motion and reported state at one time.

    p, v: m and m/s, NED. rotors_on: whether any motor is commanded to turn.
    """

    t_us: int
    p: tuple[float, float, float]
    v: tuple[float, float, float]
    state: State
    rotors_on: bool

    @property
    def height_m(self) -> float:
        """Height above the floor."""
        return -self.p[2]


class WatchedFlight:
    """A vehicle on the floor of a world, with a host that is alive and cameras that work.

    Parameters
    ----------
    world, world_seed
        Name or path of the world, and the seed of what it draws.
    flight
        Flight index, from which noise and turbulence are drawn.
    vehicle
        Name or path of the vehicle file.

    Attributes
    ----------
    cameras
        Whether poses arrive.
    vehicle
        Content of the vehicle file.
    now_us
        Time since power-up.
    samples
        One for each STEP_US.
    status
        Newest FC_STATUS; None before the first.
    texts
        Status texts of the vehicle.
    """

    def __init__(
        self, world: str, *, world_seed: int = 0, flight: int = 1, vehicle: str = "research"
    ) -> None:
        self.vehicle = load_vehicle(vehicle)
        self._simulated = SimulatedVehicle.create(
            self.vehicle, world=world, world_seed=world_seed, flight=flight, radio={"wired": True}
        )
        self.cameras = True
        self.now_us = 0
        self.samples: list[Sample] = []
        self.status: m.FcStatus | None = None
        self.texts: list[str] = []
        self._codec = Codec(*HOST)
        self._hears = Codec(*HOST)

    # What the host sends.

    def send(self, message: Message) -> None:
        """Send a message of the host."""
        self._simulated.serial_write(self._codec.encode(message))

    def command(self, number: int, *parameters: float) -> None:
        """Send COMMAND_LONG with up to seven parameters."""
        values = (*parameters, *(0.0,) * 7)[:7]
        self.send(m.CommandLong(1, 1, number, 0, *values))

    def mode(self, main: int, sub: int = 0) -> None:
        """Send MAV_CMD_DO_SET_MODE with PX4's numbers."""
        flag = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        self.command(mavlink.MAV_CMD_DO_SET_MODE, flag, float(main), float(sub))

    def set_parameter(self, name: str, value: float) -> None:
        """Send PARAM_SET."""
        self.send(m.ParamSet(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32))

    def attitude(self, thrust: float, q: tuple[float, float, float, float]) -> None:
        """Send an attitude (q_ned_frd, w first) and a share of the greatest thrust as SET_ATTITUDE_TARGET."""
        self.send(m.SetAttitudeTarget(0, 1, 1, 0, list(q), 0.0, 0.0, 0.0, thrust))

    def velocity(self, v: tuple[float, float, float]) -> None:
        """Send a velocity (NED) as SET_POSITION_TARGET_LOCAL_NED."""
        mask = _POSITION | _ACCELERATION | _YAW | _YAW_RATE
        north, east, down = v
        frame = mavlink.MAV_FRAME_LOCAL_NED
        self.send(
            m.SetPositionTarget(
                0, 1, 1, frame, mask, 0.0, 0.0, 0.0, north, east, down, 0.0, 0.0, 0.0, 0.0, 0.0
            )
        )

    # Time.

    def step(self) -> Sample:
        """Advance by STEP_US and return the new sample."""
        if self.now_us % LINK_US == 0:
            self.send(m.Timesync(0, 1000 * self.now_us))
        end_us = self.now_us + STEP_US
        simulated = self._simulated
        while simulated.now_us < end_us:
            simulated.run_until(end_us)
            for pose in simulated.mocap_read():
                if self.cameras:
                    simulated.serial_write(pose)
            self._hear(simulated.serial_read())
        self.now_us = simulated.now_us
        status = self.status
        p, v = simulated.true_motion()
        sample = Sample(
            t_us=self.now_us,
            p=p,
            v=v,
            state=State(status.state) if status is not None else State.BOOT,
            rotors_on=any(simulated.motor_command),
        )
        self.samples.append(sample)
        return sample

    def run(self, seconds: float) -> None:
        """Advance by a time."""
        for _ in range(round(1e6 * seconds / STEP_US)):
            self.step()

    def run_to(self, *states: State, seconds: float) -> bool:
        """Advance until one of these states, at most for a time; return whether it was reached."""
        steps = range(round(1e6 * seconds / STEP_US))
        return any(self.step().state in states for _ in steps)

    def hover(self, height_m: float, **parameters: float) -> None:
        """Set parameters, arm, take off and hover. Raises RuntimeError if the vehicle does not hover."""
        self.run(1.2)
        for name, value in {"TAKEOFF_SPEED": 2.0, **parameters}.items():
            self.set_parameter(name, value)
        self.run(0.1)
        self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        self.run(0.05)
        self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, math.nan, 0.0, 0.0, height_m)
        if not self.run_to(State.HOLD, seconds=30.0):
            raise RuntimeError(f"no hover at {height_m} m: {self.texts}")

    def _hear(self, data: bytes) -> None:
        for message in self._hears.decode(data) if data else ():
            if isinstance(message, m.FcStatus):
                self.status = message
            elif isinstance(message, m.StatusText):
                self.texts.append(message.text)


def impacts(samples: list[Sample]) -> list[Sample]:
    """Return the last sample before each time that a vehicle sank to the floor."""
    return [before for before, after in pairwise(samples) if before.height_m > CONTACT_M >= after.height_m]


def beyond(sample: Sample, fence: Mapping[str, float]) -> tuple[float, float]:
    """Return how far the vehicle is above the ceiling and past the walls, m; negative inside."""
    moment = Moment(parameters=fence, p=sample.p)
    return above_ceiling(moment), past_walls(moment)
