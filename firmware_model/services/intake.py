"""Bound on the messages of a station that the vehicle answers, so that a flood does not fill the downlink."""

from __future__ import annotations

from trimtab.firmware_model.services.ownership import STATIONS_MAX
from trimtab.firmware_model.services.recent import remember
from trimtab.protocol import messages as m
from trimtab.protocol.messages import Message, Station

RATE_HZ = 100
"""Messages that one station may send for long."""
OTHERS_HZ = 25
"""The same in flight for all stations together that neither own the flight nor send its poses."""
BURST_S = 2.0
"""Time over which the mean rate is bounded."""
FREE = (m.SetPositionTarget, m.SetAttitudeTarget, m.UploadChunk, m.FileTransfer)
"""Messages that are not counted, except in flight from others: uploads and setpoints come at high rates."""

LIST_COST = OTHERS_HZ
"""Messages that a request of all parameters counts for, because it has many answers.

It is half of what the smallest bucket holds, so a station that has just connected may ask.
"""


class TokenBucket:
    """Admits `rate_hz` messages a second for long, and BURST_S times as many at once."""

    def __init__(self, rate_hz: int, now_us: int) -> None:
        self._rate_hz = rate_hz
        self._tokens = BURST_S * rate_hz
        self._at_us = now_us

    def take(self, now_us: int, cost: int = 1) -> bool:
        """Return whether a message that counts for `cost` is admitted now."""
        gained = 1e-6 * (now_us - self._at_us) * self._rate_hz
        self._tokens = min(BURST_S * self._rate_hz, self._tokens + gained)
        self._at_us = now_us
        if self._tokens < cost:
            return False
        self._tokens -= cost
        return True


class Intake:
    """Decides which messages are handled, by the rates of their senders.

    `dropped` counts the messages that were not.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._buckets: dict[Station, TokenBucket] = {}
        self._others = TokenBucket(OTHERS_HZ, 0)

    def admit(self, message: Message, now_us: int, *, other: bool) -> bool:
        """Return whether to handle a message. other: whether its sender has no part in the present flight."""
        if isinstance(message, FREE) and not other:
            return True
        bucket = self._others if other else self._bucket(m.sender_of(message), now_us)
        admitted = bucket.take(now_us, LIST_COST if isinstance(message, m.ParamRequestList) else 1)
        self.dropped += not admitted
        return admitted

    def _bucket(self, station: Station, now_us: int) -> TokenBucket:
        """Return the bucket of a station."""
        bucket = self._buckets.get(station) or TokenBucket(RATE_HZ, now_us)
        remember(self._buckets, station, bucket, STATIONS_MAX)
        return bucket
