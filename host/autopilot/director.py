"""Director of a flight of another autopilot: one script from the first message to the landing, without I/O.

Its steps: find the autopilot; compare clocks; forward the cameras' poses; check; ask a person; choose the
mode; arm; fly (`StreamedFlight`). Nothing is armed before the last check. The log begins when the autopilot
acknowledges arming.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from typing import Any

from trimtab.host.autopilot.checks import check_limits
from trimtab.host.autopilot.flight import Stage, StreamedFlight
from trimtab.host.autopilot.recorder import StreamRecorder
from trimtab.host.autopilot.situation import Situation
from trimtab.host.autopilot.tasks import (
    AwaitReady,
    ChooseMode,
    Confirm,
    FindAutopilot,
    Guarded,
    confirmation_lines,
)
from trimtab.host.base.errors import FlightFailed, LinkError, Refused
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.director import Director
from trimtab.host.link.flight import ARM_PATIENCE_US, ON_REQUEST
from trimtab.host.link.flight_request import FlightEnd, FlightRequest
from trimtab.host.link.flight_tasks import AwaitPoses, Interrupted
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import Command, SettleClock, Task
from trimtab.host.log import FLIGHT_TOPICS, LogError, LogWriter, Provenance
from trimtab.host.log.provenance import flown_by
from trimtab.host.log.topics import TIMING_TOPICS
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, mavlink

POSE_US = 18_000
"""Least interval of forwarded poses. PX4's filter takes at most 50 a second without trouble."""

ERRORS_MAX = 20
"""Number of errors of the host during one landing after which it gives up."""


class StreamDirector(Director):
    """Flies one request on another autopilot."""

    def __init__(
        self,
        request: FlightRequest,
        on_phase: Callable[[str], None] | None = None,
    ) -> None:
        nodes = request.reference.nodes_ned()
        check_limits(request.reference, request.vehicle)
        camera = CameraClock(request.camera_delay_us)
        session = Session(self._script, camera, request.key, forward=self._forward)
        super().__init__(session, request, on_phase)
        kind = request.autopilot
        assert kind is not None
        self._kind = kind
        self._highest_m = -min(node.state[2] for node in nodes)
        self._situation = Situation(kind)
        self._pose_us: int | None = None
        self._may_be_armed = False
        self._stream_log: StreamRecorder | None = None
        self._flight = StreamedFlight(
            self._situation,
            request.reference,
            request.vehicle,
            on_stage=self._on_stage,
            on_reference=self._on_reference,
        )

    def interrupt(self) -> None:
        """End the flight. A flying vehicle lands first; a second call ends the session immediately."""
        at_once = self.interrupted or not self._may_be_armed or self._flight.stage is Stage.RELEASED
        self.interrupted = True
        self.session.fail(KeyboardInterrupt() if at_once else Interrupted())

    # The script.

    def _script(self, session: Session) -> Generator[Task, Any, FlightEnd]:
        request, situation = self._request, self._situation
        self._reserve_log()
        yield FindAutopilot(situation, request.port)
        self._note("checking")
        yield SettleClock()
        yield AwaitPoses(session, request.cameras)
        yield AwaitReady(situation, request.reference, request.vehicle)
        if request.ask is not None:
            self._note("waiting for confirmation")
            height_m = self._highest_m + (0.0 if situation.pose is None else situation.pose.p_ned[2])
            lines = confirmation_lines(self._kind, request.port, request.vehicle, request.reference, height_m)
            yield Confirm(situation, request.ask, lines)
            yield AwaitReady(situation, request.reference, request.vehicle, patience_us=0)
        self._note("arming")
        yield self._guarded(ChooseMode(situation), arming=False)
        return (yield from self._fly(session))

    def _guarded(self, task: Task, *, arming: bool) -> Task:
        """Return the task with all checks beside it, and with setpoints if the autopilot wants them."""
        request, streams = self._request, not self._kind.takes_off
        situation = self._situation
        return Guarded(task, situation, request.reference, request.vehicle, arming=arming, streams=streams)

    def _fly(self, session: Session) -> Generator[Task, Any, FlightEnd]:
        """Arm and fly. From here on, `self._flight` sees to it that the vehicle is disarmed at the end."""
        flight = self._flight
        self._may_be_armed = True
        failure: Exception | None = None
        is_armed, errors = False, 0
        while True:
            try:
                if failure is None and not self.interrupted and not is_armed:
                    yield self._arming()
                    is_armed = True
                    self._open_log(session.now_us)
                yield flight
                break
            except Interrupted:
                self._note(ON_REQUEST)
            except Exception as error:  # land the vehicle before any error is raised
                if failure is not None and isinstance(error, LinkError):
                    raise failure from error
                if isinstance(error, LinkError) and is_armed:
                    raise  # the flight has waited for long
                errors += 1
                if errors > ERRORS_MAX:
                    raise
                failure = failure or error
                if isinstance(error, LogError):
                    session.listener, self.log_open = None, False
                self._note("landing, the log cannot be written" if isinstance(error, LogError) else "landing")
            flight.land()
        self._note("landed")
        if isinstance(failure, Refused):
            raise FlightFailed(str(failure)) from failure
        if failure is not None:
            raise failure
        if not self.log_open:
            raise KeyboardInterrupt
        self.end = FlightEnd(
            whole=flight.finished and flight.doubt is None and not self.interrupted,
            failsafe=None,
            interrupted=self.interrupted,
            doubt=flight.doubt,
        )
        return self.end

    def _arming(self) -> Task:
        """Return the task that arms. Commands repeat: one that is refused may follow one that was not."""
        command = Command(
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), what="arm", patience_us=ARM_PATIENCE_US
        )
        return self._guarded(command, arming=True)

    def _open_log(self, now_us: int) -> None:
        request = self._request
        provenance = Provenance(
            vehicle=request.vehicle,
            reference=request.reference.to_bytes(),
            model_id=request.model_id,
            session={
                **request.session,
                **flown_by(self._situation.simulated, self.session.utc_us),
                "arm_host_us": str(now_us),
                "autopilot": self._kind.name,
            },
        )
        timing = self.session.pose_timing
        channels = FLIGHT_TOPICS if timing is None else FLIGHT_TOPICS + TIMING_TOPICS
        self._log = LogWriter(self._reserve_log(), provenance, channels)
        self.log_open = True
        self._recorder = self._stream_log = StreamRecorder(
            self._log, self.session.client, self.session.camera, request.reference, now_us, timing=timing
        )
        self._recorder.record_text("armed", now_us)
        self.session.listener = self._recorder

    # What happens in flight.

    def _forward(self, pose: m.AttPosMocap, host_us: int, vehicle_us: int | None) -> Message | None:
        """Return VISION_POSITION_ESTIMATE, stamped with the host's clock, whose offset the autopilot knows.

        Broken poses, and those that follow too soon, are not forwarded.
        """
        numbers = (pose.x, pose.y, pose.z, *pose.q)
        if not all(map(math.isfinite, numbers)) or abs(math.hypot(*pose.q) - 1.0) > 0.01:
            return None
        seen = self._situation.see(pose, host_us)
        if self._pose_us is not None and host_us - self._pose_us < POSE_US:
            return None
        self._pose_us = host_us
        return m.VisionPositionEstimate(max(0, host_us), *seen.p_ned, *seen.rpy)

    def _on_stage(self, stage: Stage) -> None:
        self._note(stage.value)
        if self._stream_log is not None and self.session.listener is not None:
            now_us = self.session.now_us
            if stage is Stage.TRACKING:
                self._stream_log.begin(self._kind.name, now_us)
            self._stream_log.record_text(self._flight.words(), now_us)

    def _on_reference(self, acts_us: int, reference_us: int, flat: Sequence[float]) -> None:
        if self._stream_log is not None and self.session.listener is not None:
            self._stream_log.setpoint(acts_us, reference_us, flat, self.session.now_us)
