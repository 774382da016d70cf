"""The flight director: it flies one request from connection to disarming, and logs the flight.

It works the same in lock-step and in real time. Its steps: connect; check the vehicle, its parameters and the
live blobs; compare clocks; forward the cameras' poses; arm; start; follow the phases until the vehicle has
disarmed. The log begins when the vehicle acknowledges arming.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Mapping
from typing import Any

from trimtab.host.base.errors import SESSION_ERRORS, FlightFailed, Refused, UsageError
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.control_stream import ControlStream
from trimtab.host.link.director import Director
from trimtab.host.link.flight_request import FlightEnd, FlightRequest
from trimtab.host.link.flight_tasks import AwaitPoses, FollowFlight, Interrupted, TakenOver
from trimtab.host.link.parameter_tasks import ReadParameters, SetParameter
from trimtab.host.link.recorder import Recorder
from trimtab.host.link.session import Session
from trimtab.host.link.swap import Swap
from trimtab.host.link.takeover import OF_CONTROLLER, OF_REFERENCE, TakeoverWatch
from trimtab.host.link.tasks import (
    Command,
    FindVehicle,
    FreshEstimate,
    FreshStatus,
    Identity,
    SettleClock,
    Task,
)
from trimtab.host.link.upload_tasks import make_live
from trimtab.host.link.vehicle_match import check_same_vehicle, neutral_feedforward
from trimtab.host.log import FLIGHT_TOPICS, LogError, LogWriter, Provenance, failsafe_name
from trimtab.host.log.provenance import flown_by
from trimtab.host.log.topics import CONTROLLED_TOPICS, ROTOR_TOPICS, TIMING_TOPICS
from trimtab.host.vehicle import to_parameters
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import FeedForward, Kind, Reference
from trimtab.protocol.messages import mavlink
from trimtab.protocol.parameters import BY_NAME, differences, equal

ARM_PATIENCE_US = 10_000_000
PHASES = {
    mavlink.TRIMTAB_STATE_BOOT: "boot",
    mavlink.TRIMTAB_STATE_STANDBY: "standby",
    mavlink.TRIMTAB_STATE_ARMED: "armed",
    mavlink.TRIMTAB_STATE_TAKEOFF: "takeoff",
    mavlink.TRIMTAB_STATE_TRACKING: "tracking",
    mavlink.TRIMTAB_STATE_HOLD: "hold",
    mavlink.TRIMTAB_STATE_LANDING: "landing",
    mavlink.TRIMTAB_STATE_FAILSAFE: "failsafe",
    mavlink.TRIMTAB_STATE_OFFBOARD: "offboard",
}
ON_REQUEST = "landing on request"
"""Phase after an interrupt, until the vehicle reports that it lands."""


class FlightDirector(Director):
    """Flies one request on a Trimtab vehicle.

    Attributes
    ----------
    identity
        Identity of the vehicle; None before it is known.
    """

    def __init__(self, request: FlightRequest, on_phase: Callable[[str], None] | None = None) -> None:
        camera = CameraClock(request.camera_delay_us)
        super().__init__(Session(self._script, camera, request.key), request, on_phase)
        self.identity: Identity | None = None
        self._swap = (
            None
            if request.then is None
            else Swap(request.then, request.swap_us, lambda: self.session.forwarded)
        )
        self._stream: ControlStream | None = None
        self._watch = TakeoverWatch(OF_REFERENCE if request.control is None else OF_CONTROLLER)
        self._on_board: dict[str, float] | None = None

    def interrupt(self) -> None:
        """End the flight. A flying vehicle lands first; a second call ends the session immediately."""
        at_once = self.interrupted or self._recorder is None
        self.interrupted = True
        self.session.fail(KeyboardInterrupt() if at_once else Interrupted())

    # The script.

    def _script(self, session: Session) -> Generator[Task, Any, FlightEnd]:
        request = self._request
        self._reserve_log()
        identity: Identity = yield FindVehicle(request.port)
        self.identity = identity
        check_same_vehicle(identity, request.vehicle.id, what="the reference", port=request.port)
        self._note("checking")
        on_board: dict[str, float] = yield ReadParameters()
        for name, value in self._request.parameters.items():
            if name not in on_board or not equal(value, on_board[name]):
                on_board[name] = yield SetParameter(name, value)
        self._on_board = on_board
        self._check_parameters(on_board)
        yield from self._ensure_live(request.reference, Kind.REFERENCE)
        yield from self._ensure_live(request.feedforward, Kind.FEEDFORWARD)
        yield SettleClock()
        yield AwaitPoses(session, request.cameras)
        self._note("arming")
        yield from self._arm()
        failure: Exception | None = None
        land = False
        while True:
            try:
                if land:
                    yield from self._land()
                else:
                    self._open_log(session.now_us)
                    yield from self._start()
                status = yield FollowFlight(self._follow, None if land else self._swap or self._stream)
                break
            except SESSION_ERRORS:
                raise
            except Interrupted:
                self._note(ON_REQUEST)
            except TakenOver:
                self._note("landing, another station took over")
            except Exception as error:  # land the vehicle before any error of the host is raised
                if failure is not None:
                    raise
                failure = error
                self.log_open = self.log_open and not isinstance(error, LogError)
                self._note("landing, the log cannot be written" if isinstance(error, LogError) else "landing")
            land = True
        self.end = self._judge(status)
        self._note("landed")
        if isinstance(failure, LogError):
            raise LogError(
                f"{failure}; the flight was ended because of this, and the vehicle has landed"
            ) from failure
        if failure is not None:
            raise failure
        return self.end

    def _check_parameters(self, on_board: Mapping[str, float]) -> None:
        expected = to_parameters(self._request.vehicle) | dict(self._request.parameters)
        different = differences(expected, on_board)
        if different and not self._request.as_flashed:
            shown = ", ".join(
                f"{name} is {actual:g}, not {nominal:g}"
                for name, (nominal, actual) in list(different.items())[:3]
            )
            more = f" and {len(different) - 3} more" if len(different) > 3 else ""
            raise UsageError(
                f"parameters on board differ from {self._request.vehicle.name}: {shown}{more}; "
                "give the vehicle file that it was set up with, set the values with --parameter, or fly it "
                "unchanged with --as-flashed"
            )

    def _ensure_live(self, blob: Reference | FeedForward | None, kind: Kind) -> Generator[Task, Any, None]:
        status = yield FreshStatus()
        field_name, name = _BLOBS[kind]
        live = bytes(getattr(status, field_name))
        if blob is None:
            if any(live) and live.hex() != neutral_feedforward(self._request.vehicle.id).id:
                raise UsageError(
                    f"the {name} {live.hex()} is live on board; give its file with --feedforward FILE, "
                    f"or remove it with `trimtab upload neutral --port {self._request.port}`"
                )
            return
        if live.hex() == blob.id:
            return
        if not self._request.upload:
            live_id = live.hex() if any(live) else "none"
            raise UsageError(
                f"the live {name} on board is {live_id}, not {blob.id}; upload it first with `trimtab upload`"
            )
        self._note(f"uploading the {name}")
        yield from make_live(blob, f"{name} {blob.id}")

    def _arm(self) -> Generator[Task, Any, None]:
        try:
            yield Command(
                mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), what="arm", patience_us=ARM_PATIENCE_US
            )
        except Refused as error:
            raise FlightFailed(str(error)) from error
        yield from self._check_unchanged()

    def _check_unchanged(self) -> Generator[Task, Any, None]:
        """Disarm and raise FlightFailed if a parameter has changed since the check."""
        checked = self._on_board or {}
        changed = differences(checked, checked | self.session.client.parameters)
        if changed:
            name, (before, now) = next(iter(changed.items()))
            with contextlib.suppress(Refused):
                yield Command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, what="disarm")
            raise FlightFailed(
                f"another station set {name} from {before:g} to {now:g} while this flight was prepared; "
                "make sure that no other station sets parameters, and fly again"
            )

    def _start(self) -> Generator[Task, Any, None]:
        """Start the flight: on the reference, or up to its height for a controller on the host.

        Raises FlightFailed if the vehicle refuses and stays on the ground. A vehicle that already flies, or
        that went into failsafe after arming, also refuses; there is a flight to follow then. The status is
        requested anew, because the last one may be older than the refusal.
        """
        command = Command(mavlink.MAV_CMD_MISSION_START, what="start")
        if self._request.control is not None:
            first = self._request.reference.nodes_ned()[0].state
            estimate: m.FcEstimate = yield FreshEstimate()
            height = max(estimate.p[2] - first[2], BY_NAME["TAKEOFF_HEIGHT"].min)
            command = Command(mavlink.MAV_CMD_NAV_TAKEOFF, (*(0.0,) * 6, height), what="take off")
        try:
            yield command
        except Refused as error:
            status: m.FcStatus = yield FreshStatus()
            failed = status.failsafe != mavlink.TRIMTAB_FAILSAFE_NONE
            if not failed and status.state <= mavlink.TRIMTAB_STATE_ARMED:
                raise FlightFailed(str(error)) from error

    def _land(self) -> Generator[Task, Any, None]:
        self._watch.commands.add(mavlink.TRIMTAB_COMMAND_LAND)
        with contextlib.suppress(Refused):
            yield Command(mavlink.MAV_CMD_NAV_LAND, what="land")

    def _open_log(self, now_us: int) -> None:
        request, client = self._request, self.session.client
        session = dict(request.session) | {"arm_host_us": str(now_us)}
        if self.identity is not None:
            session["session_uid"] = self.identity.uid
            session |= flown_by(self.identity.simulated, self.session.utc_us)
        provenance = Provenance(
            vehicle=request.vehicle,
            reference=request.reference.to_bytes(),
            feedforward=None if request.feedforward is None else request.feedforward.to_bytes(),
            then=None if request.then is None else request.then.to_bytes(),
            model_id=request.model_id,
            parameters=self._on_board,
            session=session,
        )
        channels = FLIGHT_TOPICS if request.control is None else CONTROLLED_TOPICS
        if request.vehicle.measures_rotor_speed:
            channels += ROTOR_TOPICS
        if self.session.pose_timing is not None:
            channels += TIMING_TOPICS
        self._log = LogWriter(self._reserve_log(), provenance, channels)
        self.log_open = True
        self._recorder = Recorder(
            self._log,
            client,
            self.session.camera,
            request.reference,
            now_us,
            then=request.then,
            timing=self.session.pose_timing,
        )
        self._recorder.record_text("armed", now_us)
        self.session.listener = self._recorder
        self._stream = self._control_stream(self._recorder)

    def _control_stream(self, recorder: Recorder) -> ControlStream | None:
        """Return the stream of the controller on the host, None without one."""
        request = self._request
        control = request.control
        if control is None:
            return None
        values = {**to_parameters(request.vehicle), **(self._on_board or {})}
        return ControlStream(
            control,
            request.reference,
            mass_kg=values["MASS"],
            thrust_max_n=values["THRUST_MAX"],
            on_begin=lambda start_us, now_us: recorder.begin_control(control, start_us, now_us),
            on_step=recorder.control_step,
        )

    # Following.

    def _follow(self, status: m.FcStatus) -> None:
        """Show the phase. Raises TakenOver if another station's command leaves the vehicle in the air."""
        self._note(PHASES.get(status.state, "unknown"))
        if self._watch.observe(status):
            raise TakenOver

    def _judge(self, status: m.FcStatus) -> FlightEnd:
        """Return how the flight ended, from the standby status after it."""
        request, reference = self._request, self._request.reference
        swap = None if self._swap is None else self._swap.end(bytes(status.reference_id).hex())
        if request.then is not None and swap is not None and swap.happened:
            reference = request.then
        complete = status.tracking == mavlink.TRIMTAB_TRACKING_COMPLETE
        whole = complete and bytes(status.reference_id).hex() == reference.id
        stream = self._stream
        if stream is not None:
            whole = stream.finished
        failsafe = failsafe_name(status.failsafe)
        return FlightEnd(
            whole=whole and failsafe is None and not self.interrupted and self._watch.takeover is None,
            failsafe=failsafe,
            interrupted=self.interrupted,
            swap=swap,
            stop=None if stream is None else stream.stop,
            takeover=self._watch.takeover,
        )


_BLOBS = {
    Kind.REFERENCE: ("reference_id", "reference"),
    Kind.FEEDFORWARD: ("feedforward_id", "feed-forward"),
}
