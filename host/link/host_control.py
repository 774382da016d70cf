"""A flight by a controller on the host: what to fly with, and how its stream of commands ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from trimtab.host.base.errors import UsageError
from trimtab.host.control.interface import Controller

COMPUTING_US = 10_000
"""Default of the declared computing time."""


@dataclass(frozen=True, kw_only=True)
class HostControl:
    """A controller on the host, and what the log says about it.

    Attributes
    ----------
    controller
        The controller. Its commands are body rates and collective thrust.
    name, settings_id, model_id
        Name of the controller, id of its settings and of its model of the residual, for the log.
    computing_us
        Declared computing time. A command is sent this long after the step that computes it, never earlier.
    """

    controller: Controller
    name: str
    settings_id: str
    model_id: str | None = None
    computing_us: int = COMPUTING_US

    def __post_init__(self) -> None:
        period_us = self.controller.period_us
        if not 0 <= self.computing_us <= period_us:
            raise UsageError(
                f"{self.name}: the computing time of {self.computing_us} us is not within the period of "
                f"{period_us} us; declare a time that fits, or lengthen the period"
            )


@dataclass(frozen=True, kw_only=True)
class FlownBy:
    """What flies a reference: `control` on the host, or the law on board with these `parameters`.

    `parameters` holds only values that differ from the vehicle file's.
    """

    control: HostControl | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


class ControlStop(StrEnum):
    """Why the stream of commands ended before the end of the reference."""

    NO_COMMAND = "no-command"
    ESTIMATES_LOST = "estimates-lost"
    START_MISSED = "start-missed"
    LEFT_OFFBOARD = "left-offboard"


STOP_WORDS = {
    ControlStop.NO_COMMAND: "gave no command any more",
    ControlStop.ESTIMATES_LOST: "got no estimate from the vehicle any more",
    ControlStop.START_MISSED: "was not started, because the vehicle did not come to rest at the first node",
    ControlStop.LEFT_OFFBOARD: "was not followed any more, because the vehicle left its offboard mode",
}
"""What a controller did, by the reason of its stop."""
