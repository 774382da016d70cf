"""A flight processor under test by the fuzzer: its state and its messages."""

from __future__ import annotations

from typing import Any

from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.mcu.flight_mcu import FlightMcu, flight_uart
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.codegen import function_engine
from trimtab.host.vehicle import to_parameters
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind
from trimtab.protocol.stream import StreamSplitter, message_id
from trimtab.sitl.studies.fuzz.source import Source
from trimtab.sitl.vehicle import traced_law

BAUD = 100 * 921_600
"""Fast enough for an input to arrive within one tick."""
_DAMAGE_REPORTS = (m.FcStatus.id, m.StatusText.id, m.SysStatus.id)
"""Messages that count or report bad bytes."""


class Broken(Exception):
    """A rule is violated. The text says which."""


class Board:
    """A flight processor with its store; `port` is the other end of its line."""

    def __init__(self, source: Source, port: UartPort, *, loaded: bool) -> None:
        vehicle = source.vehicle
        self.store = ReferenceStore()
        if loaded:
            for kind, blob in ((Kind.REFERENCE, source.reference), (Kind.FEEDFORWARD, source.feedforward)):
                self.store.stage(kind, blob)
                self.store.commit(kind)
        self.engine = function_engine(traced_law(), law.INPUTS, law.OUTPUTS)
        self.mcu = FlightMcu(
            engine=self.engine,
            parameters=to_parameters(vehicle),
            store=self.store,
            uid=7,
            vehicle_id=vehicle.id_bytes,
            uart=flight_uart(baud=port.baud),
        )
        self.port = port
        connect(port, self.mcu.uart)
        self._splitter = StreamSplitter()
        self._vector: Any = None
        self._values: tuple[float, ...] = ()
        self._looks = 0

    def _parameters(self) -> tuple[float, ...]:
        """Return all values. They are read after the law's were replaced, else every 16th time for speed."""
        parameters = self.mcu.parameters
        self._looks += 1
        if parameters.vector is not self._vector or self._looks % 16 == 0:
            self._vector, self._values = parameters.vector, tuple(parameters.values())
        return self._values

    def state(self) -> tuple[Any, ...]:
        """Return the state that only a valid message, or time, may change."""
        flight, store = self.mcu.flight, self.store
        return (
            flight.state,
            flight.failsafe,
            flight.action,
            flight.rotors_on,
            self._parameters(),
            *(part(kind) for kind in Kind for part in (store.live, store.staged)),
            b"".join(self.engine.inputs.values()),
        )

    def messages(self, now_us: int) -> list[bytes]:
        """Return the messages since the last call, without sequence numbers and without counts of damage."""
        frames = self._splitter.feed(self.port.read(now_us))
        return [f[5:-2] for f in frames if message_id(f) not in _DAMAGE_REPORTS]


def fast_port() -> UartPort:
    """Return a port on which no byte has to wait."""
    return UartPort(baud=BAUD, rx_bytes=1 << 16, tx_bytes=1 << 16)
