"""Message signing on board: the key, its set-up, and what is said about refused messages.

The clock of signatures needs no wall clock. It begins after the greatest timestamp that may have been used
before, runs with the processor's clock, and follows the timestamps of verified messages.

The key can be set, replaced and removed over a cable, and in standby only. The old key is not needed for
that, so a lost key can be replaced by whoever has the vehicle in hand.
"""

from __future__ import annotations

from collections.abc import Callable

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.storage.signing_store import SigningStore
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.signing import (
    NEW_STREAM_US,
    TIMESTAMP_MAX,
    UNIT_US,
    Signer,
    SigningKey,
    Verdict,
    Verifier,
)
from trimtab.protocol.uwb import PRIORITIES, Priority

TEXT_US = 5_000_000
"""Least time between two texts of one kind about refused messages."""
TEXTS = {
    Verdict.UNSIGNED: "signed messages only: give this station the key",
    Verdict.BAD_SIGNATURE: "wrong signature: this station has another key",
}
"""Texts about refused messages. Repeated and overtaken messages are normal on a radio link: no text."""
ONLY_BY_CABLE = "key not changed: connect the vehicle by cable"
ONLY_IN_STANDBY = "key not changed: only in standby"
BAD_TIME = "key not changed: the station's clock is wrong"
_WARNING, _INFO = mavlink.MAV_SEVERITY_WARNING, mavlink.MAV_SEVERITY_INFO


class SigningService:
    """Signs and verifies the messages of a codec with the key in non-volatile memory, if there is one.

    Parameters
    ----------
    codec
        The vehicle's codec, which verifies.
    sign_with
        Takes the signer of all messages that the vehicle sends, or None.
    store
        Memory of the key.
    flight
        Gives the state, sends texts, and checks at arming whether there is a key.
    wired
        Whether the port is a cable to the host rather than a line to a radio.
    """

    def __init__(
        self,
        *,
        codec: Codec,
        sign_with: Callable[[Signer | None], None],
        store: SigningStore,
        flight: Flight,
        wired: bool,
    ) -> None:
        self._codec = codec
        self._sign_with = sign_with
        self._store = store
        self._flight = flight
        self._wired = wired
        self._now_us = 0
        self._text_us: dict[str, int] = {}
        self._start(store.used + 1)

    def receive(self, data: bytes, now_us: int) -> list[Message]:
        """Return the accepted messages that `data` completes. Their timestamps are in memory."""
        verifier = self._codec.verifier
        if verifier is None:
            self._now_us = now_us
            return self._codec.decode(data)
        self.advance(now_us)
        messages = self._codec.decode(data)
        self._store.reserve(verifier.newest)
        for verdict, _ in self._codec.refused:
            if verdict in TEXTS:
                self._warn(TEXTS[verdict])
        return messages

    def advance(self, now_us: int) -> None:
        """Set the time since power-up."""
        self._now_us = now_us
        if self._codec.signer is not None and self._codec.verifier is not None:
            self._codec.signer.advance(now_us)
            self._codec.verifier.advance(now_us)

    def before_send(self) -> None:
        """Store the timestamps of the messages that are about to be sent."""
        if self._codec.signer is not None:
            self._store.reserve(self._codec.signer.newest)

    def is_authentic(self, message: Message) -> bool:
        """Return whether an accepted message is signed, or there is no key: it then keeps the link alive."""
        return self._codec.verifier is None or m.is_signed(message)

    def set_up(self, message: m.SetupSigning, now_us: int) -> None:
        """Set or remove the key, or send a text that says why not."""
        secret = bytes(message.secret_key)
        if not self._wired:
            self._warn(ONLY_BY_CABLE)
        elif self._flight.state is not State.STANDBY:
            self._warn(ONLY_IN_STANDBY)
        elif not any(secret):
            if self._store.key is not None or self._store.damaged:
                self._store.forget()
            self._start(0)
            self._text(_INFO, "signing key removed")
        elif message.initial_timestamp > TIMESTAMP_MAX:
            self._warn(BAD_TIME)
        else:
            self._install(SigningKey(secret), message.initial_timestamp)

    def _install(self, key: SigningKey, timestamp: int) -> None:
        """Store the key. The same key again changes nothing: its used timestamps must stay used."""
        if key != self._store.key:
            self._store.keep(key, max(0, timestamp - NEW_STREAM_US // UNIT_US))
            self._start(timestamp)
        self._text(_INFO, "signing key installed")

    def _start(self, epoch: int) -> None:
        """Use the key in memory. epoch: present time as a timestamp."""
        key, codec = self._store.key, self._codec
        signer = codec.verifier = None
        if key is not None:
            epoch -= self._now_us // UNIT_US
            links = {number: int(priority) for number, priority in PRIORITIES.items()}
            signer = Signer(key, link_id=int(Priority.STATUS), epoch=epoch, links=links)
            codec.verifier = Verifier(key, epoch=epoch, floor=self._store.used)
        self._sign_with(signer)
        self.advance(self._now_us)
        self._flight.monitor.has_key = key is not None

    def _warn(self, text: str) -> None:
        """Send a warning unless the same one was sent less than TEXT_US ago."""
        if self._now_us - self._text_us.get(text, -NEVER_US) >= TEXT_US:
            self._text_us[text] = self._now_us
            self._text(_WARNING, text)

    def _text(self, severity: int, text: str) -> None:
        self._flight.texts.append((severity, text))
