"""Find complete MAVLink 2 messages of the dialect in a byte stream, without decoding their payloads."""

from __future__ import annotations

import struct

from fastcrc.crc16 import mcrf4xx

from trimtab.protocol.generated.frames import MESSAGES

MAGIC = 0xFD
HEADER_BYTES = 10
OVERHEAD_BYTES = HEADER_BYTES + 2
SIGNATURE_BYTES = 13
MESSAGE_BYTES_MAX = OVERHEAD_BYTES + 255 + SIGNATURE_BYTES
"""Longest message. A splitter buffers fewer bytes than this between two calls."""

SIGNED_FLAG = 0x01
"""Incompatibility flag of a message with a signature."""
_PRIVATE = 52100
_MAGIC = bytes([MAGIC])
# id as in the header: (checksum seed, longest payload). Standard messages may have extensions that this
# dialect lacks.
_KNOWN: dict[bytes, tuple[bytes, int]] = {
    number.to_bytes(3, "little"): (bytes([seed]), longest if number >= _PRIVATE else 255)
    for number, (_, seed, longest) in MESSAGES.items()
}
_UNKNOWN = (b"", -1)
_read_header = struct.Struct("<xBB4x3s").unpack_from


def message_id(message: bytes) -> int:
    """Return the id of a complete message."""
    return message[7] | message[8] << 8 | message[9] << 16


class StreamSplitter:
    """Finds complete messages of the dialect in a stream that may lose, repeat or corrupt bytes.

    A message is valid if its id is known, its length is possible and its checksum is correct. Otherwise the
    search resumes one byte later, so a damaged message does not cost its neighbours.

    Attributes, all counts since construction:
        bad_bytes: bytes that belonged to no message.
        bad_checksums: plausible headers with a wrong checksum.
    """

    def __init__(self) -> None:
        self.bad_bytes = 0
        self.bad_checksums = 0
        self._pending = b""

    @property
    def pending_bytes(self) -> int:
        """Number of buffered bytes: a possible start of a message."""
        return len(self._pending)

    def feed(self, data: bytes, *, last: bool = False) -> list[bytes]:
        """Return the messages that `data` completes, oldest first, as the bytes of the stream.

        last: whether the stream ends with `data`. An incomplete message at the end is then searched for
        messages inside it.
        """
        data = self._pending + data if self._pending else bytes(data)
        messages: list[bytes] = []
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
            length, flags, number = _read_header(data, at)
            seed, longest = _KNOWN.get(number, _UNKNOWN)
            if length > longest or flags > SIGNED_FLAG:
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
            if mcrf4xx(data[at + 1 : stop] + seed) != data[stop] | data[stop + 1] << 8:
                self.bad_checksums += 1
                self.bad_bytes += 1
                at += 1
                continue
            messages.append(data[at:after])
            at = after
        if last:
            self.bad_bytes += end - at
            at = end
        self._pending = data[at:]
        return messages


def split(data: bytes) -> list[bytes]:
    """Return the complete messages in a datagram."""
    return StreamSplitter().feed(data, last=True)
