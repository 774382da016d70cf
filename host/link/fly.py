"""Complete flights, with a vehicle in this process or at a serial port."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator

from trimtab.host.autopilot.director import StreamDirector
from trimtab.host.autopilot.doubt import DOUBT_WORDS, Doubt
from trimtab.host.base.errors import SESSION_ERRORS, FlightFailed, TrimtabError
from trimtab.host.link.director import Director
from trimtab.host.link.drivers import DriveStatistics, Interrupts, run_lockstep, run_port
from trimtab.host.link.flight import FlightDirector
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.host_control import STOP_WORDS
from trimtab.host.link.ports import Cameras, open_port
from trimtab.host.link.pose_timing import PoseTiming
from trimtab.host.link.summary import FlightResult, summarise
from trimtab.host.link.vehicle import Vehicle
from trimtab.host.log import FAILSAFE_WORDS


class FlightEnded(FlightFailed):
    """A flight ended before its reference did. `result` holds what was measured; the log is kept."""

    def __init__(self, message: str, result: FlightResult) -> None:
        super().__init__(message)
        self.result = result


class FlightInterrupted(KeyboardInterrupt):
    """A flight was interrupted. `result` holds what was measured; the log is kept."""

    def __init__(self, message: str, result: FlightResult) -> None:
        super().__init__(message)
        self.result = result


def _director(request: FlightRequest, on_phase: Callable[[str], None] | None) -> Director:
    if request.autopilot is None:
        return FlightDirector(request, on_phase)
    return StreamDirector(request, on_phase)


def fly_lockstep(
    request: FlightRequest,
    vehicle: Vehicle,
    *,
    realtime: bool = False,
    on_phase: Callable[[str], None] | None = None,
    on_late: Callable[[str], None] | None = None,
) -> FlightResult:
    """Fly `request` with a vehicle in this process, and return the result. The vehicle stays open.

    on_late: called with a line about simulated time that runs late in real time.

    Raises FlightEnded, TrimtabError or any error of the vehicle. An interrupt raises FlightInterrupted once
    the log is closed, or KeyboardInterrupt if no log was begun.
    """
    director = _director(request, on_phase)
    late = Interrupts() if realtime else contextlib.nullcontext()
    with _settled_heap(), late:
        try:
            driven = run_lockstep(
                director.session,
                vehicle,
                realtime=realtime,
                interrupt=director.interrupt if realtime else None,
                on_late=on_late,
            )
        except Exception as error:
            director.abandon(error)
            raise
        finally:
            director.close()
        return _conclude(director, request, driven)


def fly_port(
    request: FlightRequest,
    port: str,
    mocap: str,
    *,
    on_phase: Callable[[str], None] | None = None,
    on_late: Callable[[str], None] | None = None,
) -> FlightResult:
    """Fly `request` at a serial port in real time, and return the result. Poses arrive at the `mocap` URL.

    on_late: called with a line when poses begin to arrive late, while they do, and when it is over.

    Raises the same errors as `fly_lockstep`. At Ctrl-C, SIGTERM or SIGHUP the vehicle lands first. A second
    Ctrl-C leaves the vehicle to its failsafe.
    """
    director = _director(request, on_phase)
    director.session.pose_timing = PoseTiming(on_late)
    with (
        contextlib.closing(Cameras(mocap)) as cameras,
        contextlib.closing(open_port(port)) as line,
        Interrupts(),  # a key that is held down must not stop the log from being read
    ):
        try:
            driven = run_port(director.session, line, cameras, interrupt=director.interrupt)
        except SESSION_ERRORS as error:
            raise _with_log(error, director, request) from error
        finally:
            director.close()
        return _conclude(director, request, driven)


@contextlib.contextmanager
def _settled_heap() -> Iterator[None]:
    """Exclude the existing objects from garbage collection inside the context.

    The libraries hold a hundred times as many objects as a flight; scanning them took a tenth of its time.
    """
    if gc.get_freeze_count():  # the caller has frozen the heap already
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _conclude(director: Director, request: FlightRequest, driven: DriveStatistics) -> FlightResult:
    """Return the result of a finished session, or raise its error."""
    error = director.session.error
    if isinstance(error, SESSION_ERRORS):
        raise _with_log(error, director, request)
    if error is not None and not (isinstance(error, KeyboardInterrupt) and director.log_open):
        raise error
    result = summarise(director.end, request.log_path, driven)
    end = director.end
    if end is None or end.interrupted:
        raise FlightInterrupted(_how_interrupted(director, request), result)
    if end.failsafe is not None:
        why = FAILSAFE_WORDS.get(end.failsafe, end.failsafe)
        raise FlightEnded(f"the flight ended in failsafe: {why}; its log is {request.log_path}", result)
    if end.takeover is not None:
        raise FlightEnded(
            f"the flight was interrupted: {end.takeover.words}; its log is {request.log_path}", result
        )
    if end.stop is not None and request.control is not None:
        raise FlightEnded(
            f"the controller {request.control.name} {STOP_WORDS[end.stop]}; the vehicle has landed; "
            f"its log is {request.log_path}",
            result,
        )
    if end.doubt is not None:
        landed = "" if end.doubt is Doubt.LEFT_MODE else "; the vehicle is disarmed"
        raise FlightEnded(f"{DOUBT_WORDS[end.doubt]}{landed}; its log is {request.log_path}", result)
    if not end.whole:
        raise FlightEnded(f"the flight ended before its reference did; its log is {request.log_path}", result)
    if end.swap is not None and not end.swap.happened:
        raise FlightEnded(
            f"the first reference was flown to its end, but {end.swap.reference} did not take over: "
            f"{end.swap.reason}; its log is {request.log_path}",
            result,
        )
    return result


def _how_interrupted(director: Director, request: FlightRequest) -> str:
    """Return a sentence about the state of the vehicle and the path of the log."""
    log = f"its log is {request.log_path}"
    if director.end is not None:
        return f"the vehicle has landed; {log}"
    left_to = "its failsafe" if request.autopilot is None else "its autopilot"
    return f"the vehicle is left to {left_to}; {log}" if director.interrupted else log


def _with_log(error: TrimtabError, director: Director, request: FlightRequest) -> TrimtabError:
    """Return the error, with the path of the log added if there is one."""
    if not director.log_open:
        return error
    extended = type(error)(f"{error}; the log up to this point is {request.log_path}")
    extended.details = {"log": str(request.log_path)}
    return extended
