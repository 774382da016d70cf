"""MAVLink FTP server: answers FILE_TRANSFER_PROTOCOL requests. `BlobFiles` provides the files.

Each station has its own sessions, identified by session numbers that the station chooses. The sequence number
of an answer is that of its request plus one; it increases by one with each packet of a burst. Requests that
open, close or remove a file are executed once: the server answers a repeated request with the stored answer.
Requests that change nothing are executed again. The server buffers written data and passes the complete file
on when the session is terminated. If the header of a file shows that it is too large, or no blob at all,
every write from the first on is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from trimtab.firmware_model.services.files import BlobFiles
from trimtab.firmware_model.services.recent import remember
from trimtab.protocol import messages as m
from trimtab.protocol.ftp import DATA_BYTES, Error, Opcode, Packet, crc32
from trimtab.protocol.messages import UploadResult

SESSIONS_MAX = 8
IDLE_US = 30_000_000
"""Silence after which a session ends."""
REPLAY_US = 5_000_000
"""Time for which the answer to a repeated request is stored."""
BYTES_PER_UPDATE = 120
"""Bytes of all bursts together in each update: 12 kB/s."""

_START_ERRORS = {UploadResult.TOO_LARGE: Error.INVALID_DATA_SIZE, UploadResult.BAD_REQUEST: Error.FAIL}
"""Answers to writes of a file whose first bytes show that it can only be refused."""

_Key = tuple[int, int, int]
"""System and component of the station, number of the session."""


@dataclass
class _Session:
    """An open file.

    data: the bytes to read, or those written so far. written: None for reading; else one byte for each byte
    of `data`, 1 if it was written. burst: the request that the next packet of a burst would answer.
    refused: the answer to every further write, after one that showed that the file can only be refused.
    """

    path: str
    data: bytearray
    request_us: int
    written: bytearray | None = None
    burst: Packet | None = None
    refused: Error | None = None


@dataclass(frozen=True, kw_only=True)
class _Answered:
    """The last request of a session that changed something, and its answer."""

    request: bytes
    answer: Packet
    now_us: int


class FtpServer:
    """Server for the files of `files`.

    Parameters
    ----------
    files
        Files of the vehicle.
    send
        Sends a message.
    may_write
        Returns whether a station may change files now.
    """

    def __init__(
        self,
        files: BlobFiles,
        *,
        send: Callable[[m.Message], None],
        may_write: Callable[[tuple[int, int]], bool],
    ) -> None:
        self._files = files
        self._may_write = may_write
        self._send = send
        self._sessions: dict[_Key, _Session] = {}
        self._answered: dict[_Key, _Answered] = {}
        self._credit = 0
        self._once: dict[int, Callable[[_Key, Packet, int], Packet]] = {
            Opcode.TERMINATE_SESSION: self._terminate,
            Opcode.OPEN_FILE_RO: self._open,
            Opcode.CREATE_FILE: self._create,
            Opcode.REMOVE_FILE: self._remove,
        }
        self._always: dict[int, Callable[[_Key, Packet, int], Packet | None]] = {
            Opcode.NONE: lambda key, request, now_us: _ack(request),
            Opcode.RESET_SESSIONS: self._reset,
            Opcode.LIST_DIRECTORY: self._list,
            Opcode.READ_FILE: self._read,
            Opcode.WRITE_FILE: self._write,
            Opcode.CALC_FILE_CRC32: self._checksum,
            Opcode.BURST_READ_FILE: self._burst,
        }

    def receive(self, message: m.FileTransfer, now_us: int) -> None:
        """Handle a request and answer its sender."""
        payload = bytes(message.payload)
        request = Packet.decode(payload)
        if request.opcode in (Opcode.ACK, Opcode.NAK):
            return  # an answer of another server
        key = (*m.sender_of(message), request.session)
        answered = self._answered.get(key)
        if answered and answered.request == payload and now_us - answered.now_us < REPLAY_US:
            self._answer(key, answered.answer)
            return
        session = self._sessions.get(key)
        if session is not None:
            session.request_us, session.burst = now_us, None
        act = self._once.get(request.opcode)
        if act is not None:
            answer: Packet | None = act(key, request, now_us)
            assert answer is not None
            stored = _Answered(request=payload, answer=answer, now_us=now_us)
            remember(self._answered, key, stored, 4 * SESSIONS_MAX)
        else:
            make = self._always.get(request.opcode)
            answer = _nak(request, Error.UNKNOWN_COMMAND) if make is None else make(key, request, now_us)
        if answer is not None:
            self._answer(key, answer)

    def update(self, now_us: int) -> None:
        """Continue bursts and end idle sessions."""
        if not self._sessions:
            return
        for key in [k for k, s in self._sessions.items() if now_us - s.request_us >= IDLE_US]:
            del self._sessions[key]
        bursts = [(key, session) for key, session in self._sessions.items() if session.burst is not None]
        if not bursts:
            self._credit = 0
            return
        self._credit += BYTES_PER_UPDATE
        for key, session in bursts:
            packet = session.burst
            assert packet is not None
            if self._credit < packet.size:
                break
            self._credit -= packet.size
            self._answer(key, self._next_of_burst(session, packet))
            session.request_us = now_us
            # A served session moves to the end of the queue.
            self._sessions[key] = self._sessions.pop(key)

    def _answer(self, key: _Key, packet: Packet) -> None:
        self._send(m.FileTransfer(0, key[0], key[1], packet.encode()))

    # Requests that open, close or remove a file.

    def _open(self, key: _Key, request: Packet, now_us: int) -> Packet:
        path = _path(request)
        file = self._files.find(path)
        data = None if file is None else self._files.read(file)
        if data is None:
            return _nak(request, Error.FILE_NOT_FOUND)
        if not self._begin(key, _Session(path, bytearray(data), now_us)):
            return _nak(request, Error.NO_SESSIONS_AVAILABLE)
        return _ack(request, len(data).to_bytes(4, "little"))

    def _create(self, key: _Key, request: Packet, now_us: int) -> Packet:
        path = _path(request)
        file = self._files.find(path)
        if file is None or not file.staged or not self._may_write(key[:2]):
            return _nak(request, Error.FILE_PROTECTED)
        if not self._begin(key, _Session(path, bytearray(), now_us, written=bytearray())):
            return _nak(request, Error.NO_SESSIONS_AVAILABLE)
        return _ack(request)

    def _begin(self, key: _Key, session: _Session) -> bool:
        """Open a session in place of the previous one with this key; return False if there are too many."""
        if key not in self._sessions and len(self._sessions) >= SESSIONS_MAX:
            return False
        self._sessions[key] = session
        return True

    def _terminate(self, key: _Key, request: Packet, now_us: int) -> Packet:
        session = self._sessions.pop(key, None)
        if session is None:
            return _nak(request, Error.INVALID_SESSION)
        if session.written is None:
            return _ack(request)
        if not self._may_write(key[:2]):
            return _nak(request, Error.FILE_PROTECTED)
        if session.refused is not None:
            return _nak(request, session.refused)
        count, size = sum(session.written), len(session.written)
        if count < size:
            self._files.report_incomplete(session.path, count, size)
            return _nak(request, Error.FAIL)
        staged = self._files.write(session.path, bytes(session.data), now_us)
        return _ack(request) if staged else _nak(request, Error.FAIL)

    def _remove(self, key: _Key, request: Packet, now_us: int) -> Packet:
        file = self._files.find(_path(request))
        if file is None:
            return _nak(request, Error.FILE_NOT_FOUND)
        if not file.staged or not self._may_write(key[:2]):
            return _nak(request, Error.FILE_PROTECTED)
        return _ack(request) if self._files.remove(file, now_us) else _nak(request, Error.FILE_NOT_FOUND)

    # Requests that may be executed again.

    def _reset(self, key: _Key, request: Packet, now_us: int) -> Packet:
        """End all sessions of this station and discard their buffers."""
        for memory in (self._sessions, self._answered):
            for other in [other for other in memory if other[:2] == key[:2]]:
                del memory[other]
        return _ack(request)

    def _list(self, key: _Key, request: Packet, now_us: int) -> Packet:
        entries = self._files.entries(_path(request))
        if entries is None:
            return _nak(request, Error.FILE_NOT_FOUND)
        data = b""
        for entry in entries[request.offset :]:
            line = f"D{entry.name}\0" if entry.size is None else f"F{entry.name}\t{entry.size}\0"
            if len(data) + len(line) > DATA_BYTES:
                break
            data += line.encode()
        return _ack(request, data) if data else _nak(request, Error.EOF)

    def _read(self, key: _Key, request: Packet, now_us: int) -> Packet:
        session = self._sessions.get(key)
        if session is None or session.written is not None:
            return _nak(request, Error.INVALID_SESSION)
        data = bytes(session.data[request.offset : request.offset + min(request.size, DATA_BYTES)])
        return _ack(request, data) if data else _nak(request, Error.EOF)

    def _write(self, key: _Key, request: Packet, now_us: int) -> Packet:
        session = self._sessions.get(key)
        if session is None or session.written is None:
            return _nak(request, Error.INVALID_SESSION)
        end = request.offset + len(request.data)
        if end > self._files.bytes_max or request.size > DATA_BYTES:
            return _nak(request, Error.INVALID_DATA_SIZE)
        if session.refused is None and request.offset == 0:
            session.refused = _START_ERRORS.get(self._files.check_start(session.path, request.data))
        if session.refused is not None:
            return _nak(request, session.refused)
        for memory in (session.data, session.written):
            memory.extend(bytes(max(0, end - len(memory))))
        session.data[request.offset : end] = request.data
        session.written[request.offset : end] = b"\1" * len(request.data)
        return _ack(request)

    def _checksum(self, key: _Key, request: Packet, now_us: int) -> Packet:
        file = self._files.find(_path(request))
        data = None if file is None else self._files.read(file)
        if data is None:
            return _nak(request, Error.FILE_NOT_FOUND)
        return _ack(request, crc32(data).to_bytes(4, "little"))

    def _burst(self, key: _Key, request: Packet, now_us: int) -> Packet | None:
        first = self._read(key, request, now_us)
        if first.opcode == Opcode.NAK:
            return first
        self._sessions[key].burst = request
        return None

    def _next_of_burst(self, session: _Session, request: Packet) -> Packet:
        """Return the packet that answers `request`, and advance the session's burst or end it."""
        data = bytes(session.data[request.offset : request.offset + min(request.size, DATA_BYTES)])
        end = request.offset + len(data)
        last = end >= len(session.data)
        session.burst = None
        if not last:
            session.burst = Packet(
                number=request.number + 1,
                session=request.session,
                opcode=request.opcode,
                size=request.size,
                offset=end,
            )
        return _ack(request, data, last=last)


def _path(request: Packet) -> str:
    """Return the path in a request. Bytes that are not ASCII yield a path without a file."""
    return request.data.partition(b"\0")[0].decode("ascii", errors="replace")


def _ack(request: Packet, data: bytes = b"", *, last: bool = False) -> Packet:
    return _reply(request, Opcode.ACK, data, last=last)


def _nak(request: Packet, error: Error) -> Packet:
    return _reply(request, Opcode.NAK, bytes([error]))


def _reply(request: Packet, opcode: Opcode, data: bytes, *, last: bool = False) -> Packet:
    return Packet(
        number=request.number + 1,
        session=request.session,
        opcode=opcode,
        request=request.opcode,
        size=len(data),
        burst_complete=last,
        offset=request.offset,
        data=data,
    )
