"""Counters of the link since the start of a log."""

from __future__ import annotations

from trimtab.host.link.client import Client, RadioCounts


class LinkCounts:
    """Counters of both radios and of the host's port since construction."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._messages_before = _messages(client)
        self._bytes_before = client.bytes_sent, client.bytes_received
        self._radios_before = self._radios_now = client.radio_counts
        self._radios: RadioCounts | None = None

    def radios(self) -> RadioCounts | None:
        """Return the radios' increments; None until both radios have reported twice."""
        now = self._client.radio_counts
        if now is not None and now is not self._radios_now:
            self._radios_now = now
            if self._radios_before is None:
                self._radios_before = now
            self._radios = None if now == self._radios_before else now.since(self._radios_before)
        return self._radios

    def bytes(self) -> tuple[int, int]:
        """Return the bytes sent and received on the port."""
        client, (sent, received) = self._client, self._bytes_before
        return client.bytes_sent - sent, client.bytes_received - received

    def frames(self) -> tuple[int, int, int]:
        """Return frames sent, received and lost: of both radios if they report, else the host's messages."""
        radios = self.radios()
        if radios is not None:
            # Accurate to a few frames: a frame in the air looks like a loss.
            lost = max(0, radios.up_sent - radios.up_received)
            lost += max(0, radios.down_sent - radios.down_received)
            return radios.up_sent + radios.down_sent, radios.up_received + radios.down_received, lost
        sent, received, lost = (
            b - a for a, b in zip(self._messages_before, _messages(self._client), strict=True)
        )
        # A message that was counted as lost before arming may have arrived later.
        return sent, received, max(0, lost)


def _messages(client: Client) -> tuple[int, int, int]:
    codec = client.codec
    return codec.sent, codec.received, codec.lost
