"""What directors of flights share: the session, the phase that is shown, and the log."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable

from trimtab.host.base.artefacts import reserve_log
from trimtab.host.base.parts import PartFile
from trimtab.host.link.flight_request import FlightEnd, FlightRequest
from trimtab.host.link.recorder import Recorder
from trimtab.host.link.session import Session
from trimtab.host.log import LogError, LogWriter
from trimtab.host.log.writer import publish_log


class Director(ABC):
    """Flies one request through `session`, which a driver steps. Always call `close` at the end.

    Attributes
    ----------
    session
        The session; a driver steps it.
    phase
        Name of the current phase, for display.
    end
        How the flight ended; None before.
    log_open
        Whether there is a log that can be read once it is closed.
    interrupted
        Whether the flight was interrupted.
    """

    def __init__(
        self, session: Session, request: FlightRequest, on_phase: Callable[[str], None] | None
    ) -> None:
        self.session = session
        self.phase = "connecting"
        self.end: FlightEnd | None = None
        self.log_open = False
        self.interrupted = False
        self._request = request
        self._on_phase = on_phase
        self._part: PartFile | None = None
        self._log: LogWriter | None = None
        self._recorder: Recorder | None = None

    @abstractmethod
    def interrupt(self) -> None:
        """End the flight. A flying vehicle lands first; a second call ends the session immediately."""

    @abstractmethod
    def _open_log(self, now_us: int) -> None:
        """Begin the log; `now_us` is the host's time of arming."""

    def abandon(self, error: BaseException) -> None:
        """Write the error to the log and close it. Open a log for that if arming had not happened yet."""
        with contextlib.suppress(LogError):  # the caller raises `error`, which matters more
            if self._recorder is None and self._part is not None and not self._part.file.closed:
                self._open_log(0)
            if self._recorder is not None:
                now_us = self.session.now_us
                self._recorder.record_text(f"ended by {type(error).__name__}: {error}", now_us)
            self.close()

    def close(self) -> None:
        """Close and publish the log. Raises LogError if its end cannot be written."""
        try:
            if self._log is not None and self._part is not None:
                self.session.listener = None
                self._log.close()
                if self._log.whole and not self._part.published:
                    publish_log(self._part)
        finally:
            if self._part is not None and self._request.log_part is None:
                self._part.close()

    def _reserve_log(self) -> PartFile:
        """Return the file of the log, which no other process writes. Raises UsageError."""
        if self._part is None:
            self._part = self._request.log_part or reserve_log(self._request.log_path, force=True)
        return self._part

    def _note(self, phase: str) -> None:
        """Show a new phase. An observer that fails is not called again: a flight goes on without it."""
        if phase != self.phase:
            self.phase = phase
            if self._on_phase is not None:
                try:
                    self._on_phase(phase)
                except Exception:
                    self._on_phase = None
