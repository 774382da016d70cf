"""Payload of MAVLink FTP: the 251 bytes inside FILE_TRANSFER_PROTOCOL, for requests and responses."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

PAYLOAD_BYTES = 251
DATA_BYTES = 239
_HEADER = struct.Struct("<HBBBBBBI")


class Opcode(IntEnum):
    """Requests, and the two kinds of response."""

    NONE = 0
    TERMINATE_SESSION = 1
    RESET_SESSIONS = 2
    LIST_DIRECTORY = 3
    OPEN_FILE_RO = 4
    READ_FILE = 5
    CREATE_FILE = 6
    WRITE_FILE = 7
    REMOVE_FILE = 8
    CALC_FILE_CRC32 = 14
    BURST_READ_FILE = 15
    ACK = 128
    NAK = 129


class Error(IntEnum):
    """Error code: the first byte of the data of a NAK."""

    FAIL = 1
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS_AVAILABLE = 5
    EOF = 6
    UNKNOWN_COMMAND = 7
    FILE_PROTECTED = 9
    FILE_NOT_FOUND = 10


@dataclass(frozen=True, kw_only=True)
class Packet:
    """A request or a response.

    `size` is the length of `data`; in a read request it is the number of bytes requested. `opcode` may be a
    number that Opcode does not define. `request` is the opcode of the request that a response answers.
    """

    number: int
    session: int
    opcode: int
    request: int = 0
    size: int = 0
    burst_complete: bool = False
    offset: int = 0
    data: bytes = b""

    @classmethod
    def decode(cls, payload: bytes) -> Packet:
        """Return the packet in a payload of any length. Missing bytes count as zeros."""
        payload = bytes(payload).ljust(PAYLOAD_BYTES, b"\0")
        number, session, opcode, size, request, complete, _, offset = _HEADER.unpack_from(payload)
        return cls(
            number=number,
            session=session,
            opcode=opcode,
            request=request,
            size=size,
            burst_complete=bool(complete),
            offset=offset,
            data=payload[_HEADER.size : _HEADER.size + min(size, DATA_BYTES)],
        )

    def encode(self) -> bytes:
        """Return the payload at full length. Raises ValueError if the data is too long."""
        if len(self.data) > DATA_BYTES:
            raise ValueError(f"data must have at most {DATA_BYTES} bytes, not {len(self.data)}")
        head = _HEADER.pack(
            self.number & 0xFFFF,
            self.session,
            self.opcode,
            self.size,
            self.request,
            self.burst_complete,
            0,
            self.offset & 0xFFFF_FFFF,
        )
        return (head + self.data).ljust(PAYLOAD_BYTES, b"\0")


def crc32(data: bytes) -> int:
    """Return the checksum of CALC_FILE_CRC32: initial value 0, no final inversion."""
    return zlib.crc32(data, 0xFFFF_FFFF) ^ 0xFFFF_FFFF
