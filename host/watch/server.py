"""Server that sends the messages of a log to Foxglove over its WebSocket protocol."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trimtab.host.base.errors import UsageError
from trimtab.host.base.extras import optional
from trimtab.host.log.file_time import NS_PER_US
from trimtab.host.log.scan import Entry, Scan

HOST = "127.0.0.1"
_ONCE = "once"
"""How the rate of a topic begins whose last message stays valid."""


class ViewerServer:
    """Foxglove's WebSocket at a port of this machine. Close it at the end.

    port: 0 for any free one; `port` is the one that is served. Raises UsageError without foxglove-sdk, or if
    the port cannot be served.
    """

    def __init__(self, port: int) -> None:
        self._sdk: Any = optional("foxglove", "watch")
        self._context = self._sdk.Context()
        try:
            self._server = self._sdk.start_server(name="trimtab", host=HOST, port=port, context=self._context)
        except (OSError, RuntimeError, OverflowError) as error:
            raise UsageError(f"--port {port}: cannot be served ({error}); choose another one") from error
        self.port: int = self._server.port
        self._channels: dict[int, Any] = {}
        self._lasting: dict[int, Entry] = {}

    def send(self, content: Scan, messages: Sequence[Entry]) -> None:
        """Send messages of a log, whose channels `content` holds.

        What is written once is sent again each time, for viewers that connect in flight.
        """
        for entry in messages:
            if content.channels[entry.channel_id].metadata.get("rate", "").startswith(_ONCE):
                self._lasting[entry.channel_id] = entry
        for entry in (*self._lasting.values(), *messages):
            channel = self._channel(content, entry.channel_id)
            channel.log(entry.data, log_time=NS_PER_US * entry.log_time_us)

    def _channel(self, content: Scan, number: int) -> Any:
        if number not in self._channels:
            declared = content.channels[number]
            schema = content.schemas[declared.schema_id]
            self._channels[number] = self._sdk.Channel(
                declared.topic,
                schema=self._sdk.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                message_encoding=declared.message_encoding,
                metadata=dict(declared.metadata),
                context=self._context,
            )
        return self._channels[number]

    def close(self) -> None:
        """Disconnect all viewers and free the port."""
        self._server.stop()
