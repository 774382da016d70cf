"""A server of MAVLink FTP: FILE_TRANSFER_PROTOCOL requests in, answers out; the files are BlobFiles' affair.

Every station has sessions of its own, by the numbers it chose. An answer's number is its request's plus one;
in a burst each packet's is one more. What opens, closes or removes is done once: where the same request comes
again its answer is given again; requests that change nothing are simply answered anew. What is written is
gathered apart and handed on whole when its session is terminated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from trimtab.firmware_model.services.files import BlobFiles
from trimtab.protocol import messages as m
from trimtab.protocol.ftp import DATA_BYTES, Error, Opcode, Packet, crc32

SESSIONS_MAX = 8
IDLE_US = 30_000_000
"""Silence after which a session is over."""
REPLAY_US = 5_000_000
"""How long an answer is kept for its request to come again."""
BYTES_PER_LOOK = 120
"""Of bursts, all together: 12 kB/s."""

_Key = tuple[int, int, int]
"""System and component of the station, number of the session."""


@dataclass
class _Session:
    """An open file: `data` read or gathered so far, `held` one byte for each of it where it is written."""

    path: str
    data: bytearray
    heard_us: int
    held: bytearray | None = None
    burst: Packet | None = None
    """The packet to go out next, as its request would ask for it."""


@dataclass(frozen=True, kw_only=True)
class _Answered:
    """The last request of a session that changed something, and its answer."""

    request: bytes
    answer: Packet
    now_us: int


class FtpServer:
    """Answers requests.

    Parameters
    ----------
    files
        what there is. send: puts a message on the line.
    """

    def __init__(self, files: BlobFiles, *, send: Callable[[m.Message], None]) -> None:
        self._files = files
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
            Opcode.NONE: lambda key, asked, now_us: _ack(asked),
            Opcode.RESET_SESSIONS: self._reset,
            Opcode.LIST_DIRECTORY: self._list,
            Opcode.READ_FILE: self._read,
            Opcode.WRITE_FILE: self._write,
            Opcode.CALC_FILE_CRC32: self._checksum,
            Opcode.BURST_READ_FILE: self._burst,
        }

    def receive(self, message: m.FileTransfer, now_us: int) -> None:
        """Answer the request to its sender."""
        payload = bytes(message.payload)
        asked = Packet.decode(payload)
        if asked.opcode in (Opcode.ACK, Opcode.NAK):
            return  # an answer, of another server
        key = (*m.sender_of(message), asked.session)
        answered = self._answered.get(key)
        if answered and answered.request == payload and now_us - answered.now_us < REPLAY_US:
            self._answer(key, answered.answer)
            return
        session = self._sessions.get(key)
        if session is not None:
            session.heard_us, session.burst = now_us, None
        act = self._once.get(asked.opcode)
        if act is not None:
            answer: Packet | None = act(key, asked, now_us)
            assert answer is not None
            self._answered.pop(key, None)
            self._answered[key] = _Answered(request=payload, answer=answer, now_us=now_us)
            if len(self._answered) > 4 * SESSIONS_MAX:
                del self._answered[next(iter(self._answered))]
        else:
            make = self._always.get(asked.opcode)
            answer = _nak(asked, Error.UNKNOWN_COMMAND) if make is None else make(key, asked, now_us)
        if answer is not None:
            self._answer(key, answer)

    def look(self, now_us: int) -> None:
        """Continue bursts and end idle sessions."""
        if not self._sessions:
            return
        for key in [k for k, s in self._sessions.items() if now_us - s.heard_us >= IDLE_US]:
            del self._sessions[key]
        bursts = [(key, session) for key, session in self._sessions.items() if session.burst is not None]
        if not bursts:
            self._credit = 0
            return
        self._credit += BYTES_PER_LOOK
        for key, session in bursts:
            packet = session.burst
            assert packet is not None
            if self._credit < packet.size:
                break
            self._credit -= packet.size
            self._answer(key, self._next_of_burst(session, packet))
            session.heard_us = now_us
            # Whoever was served waits behind the others.
            self._sessions[key] = self._sessions.pop(key)

    def _answer(self, key: _Key, packet: Packet) -> None:
        self._send(m.FileTransfer(0, key[0], key[1], packet.encode()))

    # What opens, closes or removes.

    def _open(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        path = _path(asked)
        file = self._files.find(path)
        data = None if file is None else self._files.read(file)
        if data is None:
            return _nak(asked, Error.FILE_NOT_FOUND)
        if not self._begin(key, _Session(path, bytearray(data), now_us)):
            return _nak(asked, Error.NO_SESSIONS_AVAILABLE)
        return _ack(asked, len(data).to_bytes(4, "little"))

    def _create(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        path = _path(asked)
        file = self._files.find(path)
        if file is None or not file.staged:
            return _nak(asked, Error.FILE_PROTECTED)
        if not self._begin(key, _Session(path, bytearray(), now_us, held=bytearray())):
            return _nak(asked, Error.NO_SESSIONS_AVAILABLE)
        return _ack(asked)

    def _begin(self, key: _Key, session: _Session) -> bool:
        """Whether there is room; what the session had open before is dropped."""
        if key not in self._sessions and len(self._sessions) >= SESSIONS_MAX:
            return False
        self._sessions[key] = session
        return True

    def _terminate(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        session = self._sessions.pop(key, None)
        if session is None:
            return _nak(asked, Error.INVALID_SESSION)
        if session.held is None:
            return _ack(asked)
        held, size = sum(session.held), len(session.held)
        if held < size:
            self._files.broken(session.path, held, size)
            return _nak(asked, Error.FAIL)
        staged = self._files.write(session.path, bytes(session.data), now_us)
        return _ack(asked) if staged else _nak(asked, Error.FAIL)

    def _remove(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        file = self._files.find(_path(asked))
        if file is None:
            return _nak(asked, Error.FILE_NOT_FOUND)
        if not file.staged:
            return _nak(asked, Error.FILE_PROTECTED)
        return _ack(asked) if self._files.remove(file, now_us) else _nak(asked, Error.FILE_NOT_FOUND)

    # What may be done again.

    def _reset(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        """All sessions of this station end, what they gathered is dropped."""
        for memory in (self._sessions, self._answered):
            for other in [other for other in memory if other[:2] == key[:2]]:
                del memory[other]
        return _ack(asked)

    def _list(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        entries = self._files.entries(_path(asked))
        if entries is None:
            return _nak(asked, Error.FILE_NOT_FOUND)
        data = b""
        for entry in entries[asked.offset :]:
            line = f"D{entry.name}\0" if entry.size is None else f"F{entry.name}\t{entry.size}\0"
            if len(data) + len(line) > DATA_BYTES:
                break
            data += line.encode()
        return _ack(asked, data) if data else _nak(asked, Error.EOF)

    def _read(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        session = self._sessions.get(key)
        if session is None or session.held is not None:
            return _nak(asked, Error.INVALID_SESSION)
        data = bytes(session.data[asked.offset : asked.offset + min(asked.size, DATA_BYTES)])
        return _ack(asked, data) if data else _nak(asked, Error.EOF)

    def _write(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        session = self._sessions.get(key)
        if session is None or session.held is None:
            return _nak(asked, Error.INVALID_SESSION)
        end = asked.offset + len(asked.data)
        if end > self._files.most_bytes or asked.size > DATA_BYTES:
            return _nak(asked, Error.INVALID_DATA_SIZE)
        for memory in (session.data, session.held):
            memory.extend(bytes(max(0, end - len(memory))))
        session.data[asked.offset : end] = asked.data
        session.held[asked.offset : end] = b"\1" * len(asked.data)
        return _ack(asked)

    def _checksum(self, key: _Key, asked: Packet, now_us: int) -> Packet:
        file = self._files.find(_path(asked))
        data = None if file is None else self._files.read(file)
        if data is None:
            return _nak(asked, Error.FILE_NOT_FOUND)
        return _ack(asked, crc32(data).to_bytes(4, "little"))

    def _burst(self, key: _Key, asked: Packet, now_us: int) -> Packet | None:
        first = self._read(key, asked, now_us)
        if first.opcode == Opcode.NAK:
            return first
        self._sessions[key].burst = asked
        return None

    def _next_of_burst(self, session: _Session, asked: Packet) -> Packet:
        """Return the packet that answers `asked`; the session's burst is then at the one behind it, or
        over.
        """
        data = bytes(session.data[asked.offset : asked.offset + min(asked.size, DATA_BYTES)])
        end = asked.offset + len(data)
        last = end >= len(session.data)
        session.burst = None
        if not last:
            session.burst = Packet(
                number=asked.number + 1,
                session=asked.session,
                opcode=asked.opcode,
                size=asked.size,
                offset=end,
            )
        return _ack(asked, data, last=last)


def _path(asked: Packet) -> str:
    """Return the path in a request; bytes that are no text make one that no file has."""
    return asked.data.partition(b"\0")[0].decode("ascii", errors="replace")


def _ack(asked: Packet, data: bytes = b"", *, last: bool = False) -> Packet:
    return _reply(asked, Opcode.ACK, data, last=last)


def _nak(asked: Packet, error: Error) -> Packet:
    return _reply(asked, Opcode.NAK, bytes([error]))


def _reply(asked: Packet, opcode: Opcode, data: bytes, *, last: bool = False) -> Packet:
    return Packet(
        number=asked.number + 1,
        session=asked.session,
        opcode=opcode,
        request=asked.opcode,
        size=len(data),
        burst_complete=last,
        offset=asked.offset,
        data=data,
    )
