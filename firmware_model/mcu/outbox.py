"""Messages that wait for the serial line, encoded and signed by the component that sends them."""

from __future__ import annotations

from collections.abc import Callable

from trimtab.firmware_model.mcu.uart import UartPort
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import PRIVATE_ID_MIN, VEHICLE_FAST, VEHICLE_PRIVATE, Message
from trimtab.protocol.signing import Signer
from trimtab.protocol.uwb import PRIORITIES, Priority


class Outbox:
    """Queue of the messages of the flight processor's components.

    Parameters
    ----------
    codec
        Codec of the autopilot component.
    uart
        Line to send on.

    Attributes
    ----------
    unsendable
        Number of messages with a value that its field cannot represent.
    unsent
        Number of messages that did not fit into the transmit buffer.
    """

    def __init__(self, codec: Codec, uart: UartPort) -> None:
        self.unsendable = 0
        self.unsent = 0
        self._codec = codec
        self._fast, self._private = Codec(*VEHICLE_FAST), Codec(*VEHICLE_PRIVATE)
        self._uart = uart
        self._out: list[bytes] = []

    def __len__(self) -> int:
        """Return the number of waiting messages."""
        return len(self._out)

    def sign_with(self, signer: Signer | None) -> None:
        """Sign all further messages, or none."""
        for codec in (self._codec, self._fast, self._private):
            codec.signer = signer

    def queue(self, message: Message) -> None:
        """Encode a message for the next `flush`."""
        if PRIORITIES[message.id] is Priority.FAST_TELEMETRY:
            encoder = self._fast
        else:
            encoder = self._private if message.id >= PRIVATE_ID_MIN else self._codec
        try:
            self._out.append(encoder.encode(message))
        except ValueError:
            self.unsendable += 1

    def flush(self, now_us: int, before_send: Callable[[], None]) -> None:
        """Send the messages that fit into the transmit buffer, after `before_send`."""
        if not self._out:
            return
        before_send()
        out, self._out = self._out, []
        data = b"".join(out)
        if len(data) <= self._uart.tx_free(now_us):
            self._uart.write(data, now_us)
            return
        for message in out:
            if not self._uart.write(message, now_us):
                self.unsent += 1
