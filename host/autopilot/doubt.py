"""Why the host ended a flight of another autopilot."""

from __future__ import annotations

from enum import StrEnum


class Doubt(StrEnum):
    """A reason to end the flight. On all but LEFT_MODE the host lands the vehicle."""

    POSES_STOPPED = "poses-stopped"
    LINK_SILENT = "link-silent"
    LEFT_MODE = "left-mode"
    LEFT_FENCE = "left-fence"
    FAR_OFF = "far-off"
    ESTIMATE_WRONG = "estimate-wrong"
    NO_TAKEOFF = "no-takeoff"
    START_MISSED = "start-missed"


DOUBT_WORDS: dict[Doubt, str] = {
    Doubt.POSES_STOPPED: "the cameras' poses stopped",
    Doubt.LINK_SILENT: "the autopilot fell silent",
    Doubt.LEFT_MODE: "the autopilot left the mode in which it follows setpoints: a pilot or its own failsafe "
    "took over",
    Doubt.LEFT_FENCE: "the vehicle left the geofence",
    Doubt.FAR_OFF: "the vehicle was too far from the reference",
    Doubt.ESTIMATE_WRONG: "the autopilot's pose and the cameras' were too far apart, or its pose stopped",
    Doubt.NO_TAKEOFF: "the vehicle did not take off",
    Doubt.START_MISSED: "the vehicle did not reach the start of the reference in time",
}
