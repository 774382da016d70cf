"""Find whole MAVLink 2 messages of the dialect in a stream of bytes, without decoding their payloads."""

from __future__ import annotations

from fastcrc.crc16 import mcrf4xx

from trimtab.protocol.generated.frames import MESSAGES

MAGIC = 0xFD
HEADER_BYTES = 10
OVERHEAD_BYTES = HEADER_BYTES + 2
SIGNATURE_BYTES = 13
LONGEST_BYTES = OVERHEAD_BYTES + 255 + SIGNATURE_BYTES
"""No message is longer, so no splitter keeps more than one byte less between two calls."""

_SIGNED = 0x01
_PRIVATE = 52100
_MAGIC = bytes([MAGIC])
# id: (checksum seed, longest payload). Standard messages may have grown extensions that we do not know.
_KNOWN: dict[int, tuple[bytes, int]] = {
    number: (bytes([seed]), longest if number >= _PRIVATE else 255)
    for number, (_, seed, longest) in MESSAGES.items()
}


def message_id(message: bytes) -> int:
    """Id of a whole message."""
    return message[7] | message[8] << 8 | message[9] << 16


class StreamSplitter:
    """Finds whole messages of the dialect in a stream that may lose, repeat or garble bytes.

    A message counts when its id is known, its length possible and its checksum right; otherwise the search
    goes on one byte further, so that a damaged message costs none of its neighbours.

    Attributes, all counts since construction:
        messages: whole messages found.
        bad_bytes: bytes that belonged to none.
        bad_checksums: plausible headers whose checksum was wrong.
    """

    def __init__(self) -> None:
        self.messages = 0
        self.bad_bytes = 0
        self.bad_checksums = 0
        self._pending = b""

    @property
    def pending_bytes(self) -> int:
        """Bytes kept for the next call: the beginning of what may become a message."""
        return len(self._pending)

    def feed(self, data: bytes, *, last: bool = False) -> list[bytes]:
        """Return the messages that `data` completes, oldest first, each exactly as it was in the stream.

        After the `last` bytes nothing is waited for: what has begun and not ended is no message, and may
        have one inside.
        """
        data = self._pending + data if self._pending else bytes(data)
        found: list[bytes] = []
        at, end = 0, len(data)
        while at < end:
            if data[at] != MAGIC:
                skipped = data.find(_MAGIC, at)
                skipped = end if skipped < 0 else skipped
                self.bad_bytes += skipped - at
                at = skipped
                continue
            if end - at < OVERHEAD_BYTES:
                break
            length, flags = data[at + 1], data[at + 2]
            known = _KNOWN.get(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)
            if known is None or length > known[1] or flags > _SIGNED:
                self.bad_bytes += 1
                at += 1
                continue
            stop = at + HEADER_BYTES + length
            after = stop + 2 + SIGNATURE_BYTES if flags else stop + 2
            if after > end:
                if not last:
                    break
                self.bad_bytes += 1
                at += 1
                continue
            if mcrf4xx(data[at + 1 : stop] + known[0]) != data[stop] | data[stop + 1] << 8:
                self.bad_checksums += 1
                self.bad_bytes += 1
                at += 1
                continue
            found.append(data[at:after])
            at = after
        if last:
            self.bad_bytes += end - at
            at = end
        self._pending = data[at:]
        self.messages += len(found)
        return found


def split(data: bytes) -> list[bytes]:
    """Return the messages in `data` alone, a datagram: what began in it and did not end is none."""
    return StreamSplitter().feed(data, last=True)
