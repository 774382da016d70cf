"""Flights from beginning to end, for verbs and whoever else has something to fly."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator

from trimtab.host.base.errors import SESSION_ERRORS, FlightFailed, TrimtabError
from trimtab.host.link.drivers import DriveStatistics, Interrupts, run_lockstep, run_port
from trimtab.host.link.flight import FlightDirector
from trimtab.host.link.flight_order import FlightOrder
from trimtab.host.link.ports import Cameras, open_port
from trimtab.host.link.summary import FlightResult, summarise
from trimtab.host.link.vehicle import Vehicle
from trimtab.host.log import FAILSAFE_WORDS


class FlightEnded(FlightFailed):
    """A flight that did not fly its reference to the end; `result` is what there is, the log is kept."""

    def __init__(self, message: str, result: FlightResult) -> None:
        super().__init__(message)
        self.result = result


class FlightInterrupted(KeyboardInterrupt):
    """A flight that was ended from outside; `result` is what there is, the log is kept."""

    def __init__(self, message: str, result: FlightResult) -> None:
        super().__init__(message)
        self.result = result


def fly_lockstep(
    order: FlightOrder,
    vehicle: Vehicle,
    *,
    realtime: bool = False,
    on_phase: Callable[[str], None] | None = None,
) -> FlightResult:
    """Return the result of flying `order` with a vehicle in this process; the vehicle stays open.

    Raises FlightEnded, TrimtabError, what the vehicle raises, and once the log is closed FlightInterrupted,
    or KeyboardInterrupt where none was begun.
    """
    director = FlightDirector(order, on_phase)
    late = Interrupts() if realtime else contextlib.nullcontext()
    with _settled_heap(), late:
        try:
            driven = run_lockstep(
                director.session,
                vehicle,
                realtime=realtime,
                interrupt=director.interrupt if realtime else None,
            )
        except Exception as error:
            director.abandon(error)
            raise
        finally:
            director.close()
        return _conclude(director, order, driven)


def fly_port(
    order: FlightOrder,
    port: str,
    mocap: str,
    *,
    on_phase: Callable[[str], None] | None = None,
) -> FlightResult:
    """Return the result of flying `order` at a serial port in real time; poses arrive at the `mocap` URL.

    Raises as `fly_lockstep` does. At Ctrl-C, SIGTERM or SIGHUP the vehicle lands first; at a second Ctrl-C it
    is left to itself.
    """
    director = FlightDirector(order, on_phase)
    with (
        contextlib.closing(Cameras(mocap)) as cameras,
        contextlib.closing(open_port(port)) as line,
        Interrupts(),  # until the log is read: a key that is held down must not end that
    ):
        try:
            driven = run_port(director.session, line, cameras, interrupt=director.interrupt)
        except SESSION_ERRORS as error:
            raise _with_log(error, director, order) from error
        finally:
            director.close()
        return _conclude(director, order, driven)


@contextlib.contextmanager
def _settled_heap() -> Iterator[None]:
    """Inside, Python's collector leaves out all that exists already.

    The libraries' objects are a hundred times those of a flight: going through them took a tenth of it.
    """
    if gc.get_freeze_count():  # somebody else's choice
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _conclude(director: FlightDirector, order: FlightOrder, driven: DriveStatistics) -> FlightResult:
    """Return the result of a session that is done, or its error."""
    error = director.session.error
    if isinstance(error, SESSION_ERRORS):
        raise _with_log(error, director, order)
    if error is not None and not (isinstance(error, KeyboardInterrupt) and director.log_open):
        raise error
    result = summarise(director, order.log_path, driven)
    end = director.end
    if end is None or end.interrupted:
        raise FlightInterrupted(_how_interrupted(director, order), result)
    if end.failsafe is not None:
        why = FAILSAFE_WORDS.get(end.failsafe, end.failsafe)
        raise FlightEnded(f"the flight ended in failsafe: {why}; its log is {order.log_path}", result)
    if not end.whole:
        raise FlightEnded(f"the flight ended before its reference did; its log is {order.log_path}", result)
    if end.swap is not None and not end.swap.happened:
        raise FlightEnded(
            f"the first reference was flown to its end, {end.swap.reference} did not take over: "
            f"{end.swap.reason}; its log is {order.log_path}",
            result,
        )
    return result


def _how_interrupted(director: FlightDirector, order: FlightOrder) -> str:
    """Return what became of the vehicle, and where the log is."""
    log = f"its log is {order.log_path}"
    if director.end is not None:
        return f"the vehicle has landed; {log}"
    return f"the vehicle is left to its failsafe; {log}" if director.interrupted else log


def _with_log(error: TrimtabError, director: FlightDirector, order: FlightOrder) -> TrimtabError:
    """Return the same error, saying where the log is if there is one."""
    if not director.log_open:
        return error
    found = type(error)(f"{error}; the log up to there is {order.log_path}")
    found.details = {"log": str(order.log_path)}
    return found
