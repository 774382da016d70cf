"""Events of a flight: phases of the vehicle's supervisor, failsafes, and texts of host and vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from foxglove_schemas_protobuf.Log_pb2 import Log

from trimtab.host.log import topics
from trimtab.host.log.flight import State
from trimtab.host.log.one_flight import Flight
from trimtab.host.log.read_topics import decoded
from trimtab.host.log.scan import Scan
from trimtab.host.log.tracks import failsafe_name

EventKind = Literal["phase", "failsafe", "text"]


@dataclass(frozen=True, kw_only=True)
class Event:
    """An event at a time of the flight's clock. `text`: the phase, the failsafe or the text of the log."""

    t_us: int
    kind: EventKind
    text: str


def read_events(records: Scan, flight: Flight) -> tuple[Event, ...]:
    """Return the changes of phase and failsafe in /fc/status and the texts in /log, in order of time.

    The phase of tracking begins when the vehicle says that it began, not with the status that says so.
    """
    texts = decoded(records.by_topic(), topics.LOG, Log)
    events = [Event(t_us=entry.log_time_us, kind="text", text=log.message) for entry, log in texts]
    status = flight.status
    if status is not None:
        names = {number: name.lower() for name, number in State.items()}
        state, failsafe = -1, 0
        for t_us, now, cause in zip(
            status.t_us.tolist(), status.state.tolist(), status.failsafe.tolist(), strict=True
        ):
            if now != state:
                tracks = now == State.TRACKING and flight.tracking is not None
                begin_us = min(t_us, flight.tracking[0]) if tracks and flight.tracking else t_us
                events.append(Event(t_us=begin_us, kind="phase", text=names.get(now, str(now))))
            if cause and cause != failsafe:
                events.append(Event(t_us=t_us, kind="failsafe", text=failsafe_name(cause) or str(cause)))
            state, failsafe = now, cause
    return tuple(sorted(events, key=lambda event: event.t_us))
