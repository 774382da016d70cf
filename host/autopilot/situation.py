"""What the host knows of an autopilot and of the cameras' view of it: the newest of each message."""

from __future__ import annotations

import math
from typing import NamedTuple

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import matrix_to_euler, quat_to_matrix
from trimtab.host.autopilot.kinds import AutopilotKind
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink

FRESH_US = 200_000
"""Age of a position, against the newest pose, above which the two are not compared."""


class Pose(NamedTuple):
    """A camera pose: time of exposure (host, us), position (NED, m), and roll, pitch and yaw (FRD, rad)."""

    t_us: int
    p_ned: tuple[float, float, float]
    rpy: tuple[float, float, float]

    @property
    def yaw(self) -> float:
        """Yaw, rad."""
        return self.rpy[2]


class Situation:
    """Newest state of one autopilot. `kind` decodes its modes.

    Attributes
    ----------
    armed, mode
        Of the newest heartbeat; False and None before the first.
    heartbeat_us
        Host time of the newest heartbeat; None before the first.
    position, attitude, health, landed
        Newest LOCAL_POSITION_NED, ATTITUDE, SYS_STATUS, and MAV_LANDED_STATE; None before the first.
    position_us, attitude_us, heard_us
        Host time at which `position`, `attitude` and any message in `wants` arrived; None before the first.
    simulated
        True if it says that it is a simulated vehicle of Trimtab, else None: other simulators do not say so.
    pose
        Newest valid pose of the cameras; None before the first.
    """

    wants: tuple[type[Message], ...] = (
        m.Heartbeat,
        m.LocalPositionNed,
        m.Attitude,
        m.SysStatus,
        m.ExtendedSysState,
        m.AutopilotVersion,
    )

    def __init__(self, kind: AutopilotKind) -> None:
        self.kind = kind
        self.armed = False
        self.mode: int | None = None
        self.heartbeat_us: int | None = None
        self.position: m.LocalPositionNed | None = None
        self.position_us: int | None = None
        self.attitude: m.Attitude | None = None
        self.attitude_us: int | None = None
        self.heard_us: int | None = None
        self.health: m.SysStatus | None = None
        self.landed: int | None = None
        self.simulated: bool | None = None
        self.pose: Pose | None = None

    def receive(self, message: Message, now_us: int) -> None:
        """Take a message. Those of other components, and heartbeats of another make, do not count."""
        is_other = isinstance(message, m.Heartbeat) and message.autopilot != self.kind.number
        if m.sender_of(message) != m.VEHICLE or is_other:
            return
        self.heard_us = now_us
        if isinstance(message, m.Heartbeat):
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.mode = self.kind.mode(message.custom_mode)
            self.heartbeat_us = now_us
        elif isinstance(message, m.LocalPositionNed):
            self.position, self.position_us = message, now_us
        elif isinstance(message, m.Attitude):
            self.attitude, self.attitude_us = message, now_us
        elif isinstance(message, m.SysStatus):
            self.health = message
        elif isinstance(message, m.ExtendedSysState):
            self.landed = message.landed_state
        elif isinstance(message, m.AutopilotVersion):
            self.simulated = True if message.board_version == m.SIMULATED_BOARD else None

    def see(self, pose: m.AttPosMocap, t_us: int) -> Pose:
        """Take a valid camera pose that was exposed at the host's time `t_us`, and return it."""
        rpy = matrix_to_euler(FLOAT, quat_to_matrix(FLOAT, pose.q))
        self.pose = Pose(t_us, (pose.x, pose.y, pose.z), (rpy[0], rpy[1], rpy[2]))
        return self.pose

    @property
    def streamed(self) -> bool:
        """Whether the autopilot is in the mode in which it follows setpoints."""
        return self.mode == self.kind.streamed_mode

    def mode_name(self) -> str:
        """Return the name of the mode for messages."""
        return "no mode" if self.mode is None else self.kind.mode_name(self.mode)

    def pose_age_us(self, now_us: int) -> float:
        """Return the age of the newest pose; infinite before the first."""
        return math.inf if self.pose is None else now_us - self.pose.t_us

    def estimate_age_us(self, now_us: int) -> float:
        """Return the age of the older of position and attitude; infinite without both."""
        if self.position_us is None or self.attitude_us is None:
            return math.inf
        return now_us - min(self.position_us, self.attitude_us)

    def disagreement(self) -> tuple[float, float] | None:
        """Return distance (m) and yaw (rad) between the autopilot's estimate and the newest pose.

        Position and yaw are moved on to the time of the pose by their rates. None without both, or if either
        is older than the pose by more than FRESH_US.
        """
        position, attitude = self.position, self.attitude
        position_us, attitude_us = self.position_us, self.attitude_us
        if self.pose is None or position is None or attitude is None:
            return None
        assert position_us is not None
        assert attitude_us is not None
        if self.pose.t_us - min(position_us, attitude_us) > FRESH_US:
            return None
        later_s = 1e-6 * (self.pose.t_us - position_us)
        x, y, z = (p + later_s * v for p, v in zip(*_motion(position), strict=True))
        distance_m = math.dist((x, y, z), self.pose.p_ned)
        yaw = attitude.yaw + 1e-6 * (self.pose.t_us - attitude_us) * attitude.yawspeed
        turn = yaw - self.pose.yaw
        return distance_m, abs(math.remainder(turn, 2.0 * math.pi)) if math.isfinite(turn) else math.inf


def _motion(position: m.LocalPositionNed) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return (position.x, position.y, position.z), (position.vx, position.vy, position.vz)
