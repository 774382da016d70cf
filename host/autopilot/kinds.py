"""The autopilots that can be flown: their modes and what they need, as numbers on the link."""

from __future__ import annotations

from dataclasses import dataclass

from trimtab.host.base.errors import UsageError
from trimtab.protocol.messages import mavlink

_CUSTOM = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)


@dataclass(frozen=True, kw_only=True)
class AutopilotKind:
    """One make of autopilot.

    Attributes
    ----------
    name
        Value of --autopilot.
    title
        Name of the make in messages.
    number
        MAV_AUTOPILOT of its heartbeat.
    streamed_mode
        HEARTBEAT.custom_mode of the mode in which it follows setpoints, masked with `mode_mask`.
    mode_mask
        Bits of custom_mode that name the mode.
    set_streamed_mode
        Parameters of MAV_CMD_DO_SET_MODE for the mode in which it follows setpoints.
    land
        Commands that land it, each with its parameters. They are sent in turn until one is accepted.
    takes_off
        Whether it needs MAV_CMD_NAV_TAKEOFF before it follows setpoints.
    pose_advice
        What to set on board if it takes no poses.
    modes
        Names of modes by custom_mode, for messages.
    """

    name: str
    title: str
    number: int
    streamed_mode: int
    mode_mask: int
    set_streamed_mode: tuple[float, ...]
    land: tuple[tuple[int, tuple[float, ...]], ...]
    takes_off: bool
    pose_advice: str
    modes: dict[int, str]

    def mode(self, custom_mode: int) -> int:
        """Return the mode in HEARTBEAT.custom_mode, comparable with the modes of this class."""
        return custom_mode & self.mode_mask

    def mode_name(self, custom_mode: int) -> str:
        """Return the name of the mode in HEARTBEAT.custom_mode, or its number."""
        mode = self.mode(custom_mode)
        return self.modes.get(mode, f"mode {mode}")


def _px4(main: int, sub: int = 0) -> int:
    return sub << 24 | main << 16


PX4 = AutopilotKind(
    name="px4",
    title="PX4",
    number=mavlink.MAV_AUTOPILOT_PX4,
    streamed_mode=_px4(6),
    mode_mask=0xFFFF_0000,
    set_streamed_mode=(_CUSTOM, 6.0),
    land=((mavlink.MAV_CMD_DO_SET_MODE, (_CUSTOM, 4.0, 6.0)), (mavlink.MAV_CMD_NAV_LAND, ())),
    takes_off=False,
    pose_advice="set EKF2_EV_CTRL to take position and yaw, and EKF2_HGT_REF to vision",
    modes={
        _px4(1): "MANUAL",
        _px4(2): "ALTCTL",
        _px4(3): "POSCTL",
        _px4(4, 1): "READY",
        _px4(4, 2): "TAKEOFF",
        _px4(4, 3): "HOLD",
        _px4(4, 4): "MISSION",
        _px4(4, 5): "RTL",
        _px4(4, 6): "LAND",
        _px4(5): "ACRO",
        _px4(6): "OFFBOARD",
        _px4(7): "STABILIZED",
    },
)
ARDUPILOT = AutopilotKind(
    name="ardupilot",
    title="ArduPilot",
    number=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    streamed_mode=4,
    mode_mask=0xFFFF_FFFF,
    set_streamed_mode=(_CUSTOM, 4.0),
    land=((mavlink.MAV_CMD_DO_SET_MODE, (_CUSTOM, 9.0)), (mavlink.MAV_CMD_NAV_LAND, ())),
    takes_off=True,
    pose_advice="set VISO_TYPE to 1, EK3_SRC1_POSXY, _POSZ and _YAW to 6, _VELXY and _VELZ to 0 or 6, and "
    "the EKF's origin in a ground station",
    modes={
        0: "STABILIZE",
        1: "ACRO",
        2: "ALT_HOLD",
        3: "AUTO",
        4: "GUIDED",
        5: "LOITER",
        6: "RTL",
        9: "LAND",
        16: "POSHOLD",
        17: "BRAKE",
    },
)
KINDS: dict[str, AutopilotKind] = {kind.name: kind for kind in (PX4, ARDUPILOT)}


def autopilot_kind(name: str) -> AutopilotKind:
    """Return the kind of this name. Raises UsageError if there is none."""
    if name not in KINDS:
        raise UsageError(f"--autopilot {name}: give {' or '.join(KINDS)}")
    return KINDS[name]
