"""Stand-in for another autopilot: a simulated vehicle whose port speaks as PX4 or ArduPilot would.

It lets a user rehearse a flight by setpoints. It is not PX4 or ArduPilot: behind it flies this project's
firmware model, and only what a flight by setpoints needs is translated:

* poses: VISION_POSITION_ESTIMATE, stamped with the host's clock, becomes ATT_POS_MOCAP on the vehicle's;
* modes: the mode in which setpoints are followed can be chosen before arming, as on those autopilots;
* heartbeats: make and mode; private messages of this project and of its radios are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_from_euler
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.sitl.serve import ServeStatistics, serve

MODE_US = 300_000
"""Interval at which the vehicle is asked to follow setpoints until it does."""
SETPOINTS_US = 500_000
"""Age of the newest setpoint above which PX4 refuses its offboard mode."""
LOST_US = 1_000_000
"""Age of the newest setpoint above which PX4 leaves that mode, by default."""
_OFFBOARD = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), 6.0)
_LANDING = (mavlink.TRIMTAB_STATE_LANDING, mavlink.TRIMTAB_STATE_FAILSAFE)


@dataclass(frozen=True, kw_only=True)
class Make:
    """How one make differs: its MAV_AUTOPILOT, modes on the link, and whether it takes off by itself.

    `streamed`, `landing` and `hold` are its modes as HEARTBEAT.custom_mode: the one that follows setpoints, a
    landing, and the one that it is in otherwise. `choose` and `land` are parameters 2 and 3 of
    MAV_CMD_DO_SET_MODE for the first two.
    """

    number: int
    streamed: int
    landing: int
    hold: int
    choose: tuple[float, float]
    land: tuple[float, float]
    takes_off: bool


MAKES: dict[str, Make] = {
    "px4": Make(
        number=mavlink.MAV_AUTOPILOT_PX4,
        streamed=6 << 16,
        landing=6 << 24 | 4 << 16,
        hold=3 << 24 | 4 << 16,
        choose=(6.0, 0.0),
        land=(4.0, 6.0),
        takes_off=False,
    ),
    "ardupilot": Make(
        number=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        streamed=4,
        landing=9,
        hold=0,
        choose=(4.0, 0.0),
        land=(9.0, 0.0),
        takes_off=True,
    ),
}


class StandIn:
    """A vehicle behind another autopilot's link. Satisfies host.link.Vehicle, and can be served.

    Parameters
    ----------
    vehicle
        The simulated vehicle.
    make
        Name of the autopilot, a key of MAKES.
    """

    def __init__(self, vehicle: Any, make: str) -> None:
        self._vehicle = vehicle
        self._make = MAKES[make]
        self._begin()

    def _begin(self) -> None:
        self._from_host, self._to_vehicle = Codec(*m.HOST), Codec(*m.HOST)
        self._from_vehicle, self._to_host = Codec(*m.VEHICLE), Codec(*m.VEHICLE)
        self._offset_us: float = math.inf  # vehicle's clock minus host's
        self._chosen = False
        self._queue: list[Message] = []
        self._asked_us = self._setpoint_us = -SETPOINTS_US
        self._state = mavlink.TRIMTAB_STATE_BOOT
        self._armed = False

    # Interface to the host.

    @property
    def now_us(self) -> int:
        """Time since the vehicle was made, us."""
        return self._vehicle.now_us

    def run_until(self, t_us: int) -> int:
        """Run the vehicle until `t_us`, or until something waits for the host. Return the time reached."""
        return self._vehicle.run_until(t_us)

    def serial_read(self) -> bytes:
        """Return the bytes that the autopilot has sent since the last call."""
        messages = self._from_vehicle.decode(self._vehicle.serial_read())
        self._queue += [answer for message in messages if (answer := self._answer(message)) is not None]
        self._ask_for_offboard()
        answers, self._queue = self._queue, []
        return b"".join(map(self._to_host.encode, answers))

    def serial_write(self, data: bytes) -> None:
        """Send bytes to the autopilot."""
        self._pass_on(
            [each for message in self._from_host.decode(data) for each in self._translated(message)]
        )

    def serial_room(self) -> int:
        """Return how many bytes to write at most."""
        return self._vehicle.serial_room()

    def mocap_read(self) -> list[bytes]:
        """Return the camera system's datagrams since the last call."""
        return self._vehicle.mocap_read()

    def power_cycle(self, flight: int) -> None:
        """Restart the vehicle for another flight."""
        self._vehicle.power_cycle(flight)
        self._begin()

    def close(self) -> None:
        """Close the vehicle."""
        self._vehicle.close()

    def truth(self) -> dict[str, Any]:
        """Return the sealed truth of the vehicle. For checks only."""
        return self._vehicle.truth()

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

    # From the host.

    def _pass_on(self, messages: Sequence[Message]) -> None:
        if messages:
            self._vehicle.serial_write(b"".join(map(self._to_vehicle.encode, messages)))

    def _translated(self, message: Message) -> list[Message]:
        """Return what the vehicle gets for a message of the host."""
        if isinstance(message, m.VisionPositionEstimate):
            return self._pose(message)
        if isinstance(message, m.Heartbeat):  # the vehicle sends stock telemetry to any other station
            return [
                m.Heartbeat(message.type, message.autopilot, message.base_mode, 0, message.system_status, 3)
            ]
        if isinstance(message, m.Timesync) and message.tc1 == 0:
            self._offset_us = min(self._offset_us, self._vehicle.clock_us - message.ts1 // 1000)
        if isinstance(message, m.SetPositionTarget):
            self._setpoint_us = self.now_us
        if isinstance(message, m.CommandLong) and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            return self._set_mode(message)
        return [message]

    def _pose(self, message: m.VisionPositionEstimate) -> list[Message]:
        """Return the pose on the vehicle's clock; none before the first clock request."""
        if not math.isfinite(self._offset_us):
            return []
        stamp_us = max(0, round(message.usec + self._offset_us))
        q = quat_from_euler(FLOAT, message.roll, message.pitch, message.yaw)
        return [m.AttPosMocap(stamp_us, list(q), message.x, message.y, message.z)]

    def _set_mode(self, message: m.CommandLong) -> list[Message]:
        """Choose the mode that follows setpoints here, and pass all other modes on."""
        wanted = (message.param2, message.param3)
        if wanted != self._make.choose:
            self._chosen &= wanted == self._make.land  # a landing shows in the vehicle's own state
            return [message]
        streaming = self._make.takes_off or self.now_us - self._setpoint_us < SETPOINTS_US
        self._chosen = self._chosen or streaming
        accepted = mavlink.MAV_RESULT_ACCEPTED if streaming else mavlink.MAV_RESULT_TEMPORARILY_REJECTED
        self._queue.append(m.CommandAck(mavlink.MAV_CMD_DO_SET_MODE, accepted, 0, 0, *m.sender_of(message)))
        return []

    def _ask_for_offboard(self) -> None:
        """Let an armed vehicle follow setpoints, once it may: PX4 from the floor, ArduPilot in the air."""
        ready = [mavlink.TRIMTAB_STATE_HOLD]
        if not self._make.takes_off:
            ready.append(mavlink.TRIMTAB_STATE_ARMED)
            if self._armed and self.now_us - self._setpoint_us > LOST_US:
                self._chosen = False
        fresh = self.now_us - self._setpoint_us < SETPOINTS_US
        may = self._armed and self._chosen and fresh and self._state in ready
        if may and self.now_us - self._asked_us >= MODE_US:
            self._asked_us = self.now_us
            values = [*_OFFBOARD, *(0.0,) * 5]
            self._pass_on([m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_DO_SET_MODE, 0, *values)])

    # To the host.

    def _answer(self, message: Message) -> Message | None:
        """Return what the host gets for a message of the vehicle."""
        if m.sender_of(message) != m.VEHICLE:
            return None
        if isinstance(message, m.Heartbeat):
            return self._heartbeat(message)
        of_mode = isinstance(message, m.CommandAck) and message.command == mavlink.MAV_CMD_DO_SET_MODE
        asks = self._chosen and self._state != mavlink.TRIMTAB_STATE_OFFBOARD  # by itself, not the host
        return None if of_mode and asks else message

    def _heartbeat(self, message: m.Heartbeat) -> Message:
        """Return the heartbeat as this make sends it."""
        self._state = message.custom_mode & 0xF
        self._armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if self._state in _LANDING:
            self._chosen = False
            mode = self._make.landing
        else:
            mode = self._make.streamed if self._chosen else self._make.hold
        return m.Heartbeat(message.type, self._make.number, message.base_mode, mode, message.system_status, 3)
