"""The swap of references in flight: the agreement on its tick, and the change of the track at that tick."""

from __future__ import annotations

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight import track
from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.flight.swap import agree_swap
from trimtab.protocol.blobs import Kind, Reference
from trimtab.protocol.messages import UploadResult
from trimtab.protocol.telemetry import TICK_US, unwrap_tick
from trimtab.protocol.upload import SwapAnswer


class AgreedSwap:
    """The agreed swap, if there is one.

    Attributes
    ----------
    at_us
        Time of the agreed swap; NEVER_US if none is agreed.
    """

    def __init__(self, flight: Flight, parameters: ParameterValues) -> None:
        self.at_us = NEVER_US
        self._flight = flight
        self._parameters = parameters
        self._next_track: track.Track | None = None

    def agree(self, kind: int, data: bytes, at_tick: int, now_us: int) -> SwapAnswer:
        """Return the answer to a swap request, which cancels any earlier agreement."""
        self.at_us, flight = NEVER_US, self._flight
        if kind != Kind.REFERENCE:
            return SwapAnswer(result=UploadResult.BAD_REQUEST)
        live, start_us = flight.reference, flight.tracking_us
        if flight.state is not State.TRACKING or live is None or start_us is None:
            return SwapAnswer(result=UploadResult.BUSY)
        blob = Reference.from_bytes(data)
        next_track = track.track(blob.nodes_ned(), blob.yaw_nodes())
        at_us = TICK_US * unwrap_tick(at_tick, now_us // TICK_US)
        answer = agree_swap(
            live,
            blob,
            next_track,
            at_us=at_us - start_us,
            ahead_us=at_us - now_us,
            limits=self._parameters.limits,
        )
        if answer.result is UploadResult.OK:
            self._next_track, self.at_us, flight.changed = next_track, at_us, True
        return answer

    def run(self) -> bool:
        """Track the agreed reference from its tick on; return False if the vehicle tracks no reference."""
        at_us, self.at_us = self.at_us, NEVER_US
        if self._flight.state is not State.TRACKING or self._next_track is None:
            return False
        self._flight.swap(self._next_track, at_us)
        return True

    def call_off(self) -> None:
        """Cancel the agreement."""
        self.at_us = NEVER_US
        self._flight.changed = True
