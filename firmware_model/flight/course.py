"""Course of a flight: its owner, the last command that changed its state, and its tracking."""

from __future__ import annotations

from enum import IntEnum

from trimtab.firmware_model.flight.supervisor import COMMANDS, Event, State
from trimtab.protocol.messages import Station


class Tracking(IntEnum):
    """How far a flight has tracked its reference. FC_STATUS reports the values."""

    NONE = 0
    RUNNING = 1
    COMPLETE = 2  # to the end of the reference without a break
    INTERRUPTED = 3


class Course:
    """Course of the present flight; on the floor, of the last one.

    Attributes
    ----------
    owner
        Station that armed the vehicle; None in standby, or if no station armed it.
    tracking
        How far the flight has tracked its reference.
    command, commander
        Last command that changed the state, and the station that gave it; None before the first command, or
        if no station gave it.
    """

    def __init__(self) -> None:
        self.owner: Station | None = None
        self.tracking = Tracking.NONE
        self.command: Event | None = None
        self.commander: Station | None = None

    def enter(self, state: State, event: Event, by: Station | None) -> None:
        """Record that `event` has led into `state`; `by`: the station that commanded it."""
        if event is Event.ARM:
            self.owner, self.tracking = by, Tracking.NONE
        elif state is State.STANDBY:
            self.owner = None
        if event in COMMANDS:
            self.command, self.commander = event, by
        if state is State.TRACKING:
            self.tracking = Tracking.RUNNING
        elif event is Event.REFERENCE_ENDED:
            self.tracking = Tracking.COMPLETE
        elif self.tracking is Tracking.RUNNING:
            self.tracking = Tracking.INTERRUPTED
