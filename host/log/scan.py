"""Reader of all undamaged records of a log file.

The file is read once from start to end, which works for closed files and for those whose writer was killed.
Chunks are parsed here, because the mcap package's reader is slower.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Metadata, Schema
from mcap.stream_reader import StreamReader

from trimtab.host.base.bounds import LOG_CONTENT, LOG_MESSAGES, LOG_RECORD_BYTES, Bound
from trimtab.host.log.errors import LogError, foreign_log, unreadable
from trimtab.host.log.file_time import file_units_per_us
from trimtab.host.log.mcap_file import MAGIC
from trimtab.host.log.provenance import PROVENANCE

_DAMAGE = (
    McapError,  # EndOfFile, InvalidMagic, RecordLengthLimitExceeded
    struct.error,
    OverflowError,
    ValueError,  # a failed CRC, text that is no UTF-8
    zstandard.ZstdError,
    MemoryError,
)
_USED = (Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.FOOTER)
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


class Entry(NamedTuple):
    """One message: channel, sequence number, both times in us from the start of the log, protobuf bytes."""

    channel_id: int
    sequence: int
    log_time_us: int
    publish_time_us: int
    data: bytes


@dataclass(kw_only=True)
class Scan:
    """Undamaged content of a file: schemas and channels by number, messages in file order, provenance.

    `whole`: the writer closed the file and nothing in it is damaged. Otherwise, `damage` describes the first
    problem. `chunks` counts the undamaged chunks, `content_bytes` what is in them; damaged ones are left out.
    """

    path: Path
    id: str
    size: int
    whole: bool = False
    damage: str = ""
    chunks: int = 0
    content_bytes: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Entry] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, tuple[str, bytes]] = field(default_factory=dict)

    @property
    def is_foreign(self) -> bool:
        """Whether another program wrote the file: Trimtab writes its provenance before any topic."""
        return bool(self.channels) and PROVENANCE not in self.metadata

    def by_topic(self) -> dict[str, list[Entry]]:
        """Return the messages of every topic that has a channel, in file order."""
        topics: dict[str, list[Entry]] = {channel.topic: [] for channel in self.channels.values()}
        names = {number: channel.topic for number, channel in self.channels.items()}
        for message in self.messages:
            topics[names[message.channel_id]].append(message)
        return topics


def scan(path: Path) -> Scan:
    """Return the undamaged content of the file at `path`, closed or cut.

    Raises LogError if the file does not exist or is not an MCAP file.
    """
    try:
        content = path.read_bytes()
    except IsADirectoryError:
        raise foreign_log(path, "is a folder") from None
    except OSError as error:
        raise unreadable(path, error) from error
    if not content:
        raise LogError(f"{path}: is empty; give a flight log written by trimtab fly or trimtab import")
    if not content.startswith(MAGIC):
        raise foreign_log(path, "is not an MCAP file")
    result = Scan(path=path, id=hashlib.sha256(content).hexdigest()[:12], size=len(content))
    reader = StreamReader(
        BytesIO(_without_message_indexes(content)),
        emit_chunks=True,
        record_size_limit=min(len(content), LOG_RECORD_BYTES.limit),
    )
    chunks: list[Chunk] = []
    errors: list[BaseException] = []
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                chunks.append(record)  # parsed last, because the summary also declares channels
            else:
                _take_record(result, record)
    except _DAMAGE as error:
        errors.append(error)
    for chunk in chunks:
        try:
            _take_chunk(result, chunk)
        except _DAMAGE as error:
            errors.append(error)
    if errors:
        left_out = len(chunks) - result.chunks
        result.whole = False
        result.damage = f"{type(errors[0]).__name__}, {result.chunks} whole chunks" + (
            f", {left_out} damaged" if left_out else ""
        )
    return result


def holds_chunk(path: Path) -> bool:
    """Return whether a file holds a whole chunk; without one, nothing can be recovered. Raises OSError."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return False
        while len(head := file.read(_RECORD.size)) == _RECORD.size:
            opcode, length = _RECORD.unpack(head)
            end = file.tell() + length
            if opcode == Opcode.CHUNK or end > size:
                return end <= size
            file.seek(end)
    return False


def _without_message_indexes(content: bytes) -> bytes:
    """Return the file without its message indexes, which are not used and take long to parse."""
    parts, start, size = [], 0, len(content)
    offset = len(MAGIC)
    while offset + _RECORD.size <= size:
        opcode, length = _RECORD.unpack_from(content, offset)
        end = offset + _RECORD.size + length
        if opcode == Opcode.FOOTER or end > size:
            break
        if opcode == Opcode.MESSAGE_INDEX:
            parts.append(content[start:offset])
            start = end
        offset = end
    return b"".join([*parts, content[start:]])


def _take_record(result: Scan, record: object) -> None:
    """Add a record of the file or of a chunk, if its type is used."""
    if isinstance(record, Metadata):
        result.metadata[record.name] = record.metadata
    elif isinstance(record, Attachment):
        result.attachments[record.name] = (record.media_type, record.data)
    elif isinstance(record, Schema):
        result.schemas[record.id] = record
    elif isinstance(record, Channel):
        result.channels[record.id] = record
    elif isinstance(record, Footer):
        result.whole = True


def _data_of(chunk: Chunk) -> bytes:
    """Return the uncompressed bytes of a chunk. Raises ValueError if it contradicts itself."""
    if chunk.uncompressed_size > LOG_RECORD_BYTES.limit:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    if chunk.compression == "zstd":
        # The frame states its size too, and the decompressor allocates what it states.
        if zstandard.frame_content_size(chunk.data) != chunk.uncompressed_size:
            raise ValueError("a chunk states two sizes")
        data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk fails its CRC")
    return data


def _framed_record(framed: bytes) -> object:
    """Return the record in bytes that hold its opcode, its length and its body."""
    # StreamReader reads them like a file without the magic bytes.
    return next(iter(StreamReader(BytesIO(framed), skip_magic=True, emit_chunks=True).records))


def take_grown(result: Scan, data: bytes) -> int:
    """Add the complete records at the begin of `data`, which follow those that `result` holds.

    Return how many bytes they take. Raises LogError if they are damaged.
    """
    offset = 0
    while offset + _RECORD.size <= len(data) and not result.whole:
        opcode, length = _RECORD.unpack_from(data, offset)
        end = offset + _RECORD.size + length
        if length > LOG_RECORD_BYTES.limit:
            raise LogError(f"{result.path}: holds a record of {length} bytes; the file is damaged")
        if end > len(data):
            break
        if opcode in _USED:
            try:
                record = _framed_record(data[offset:end])
                if isinstance(record, Chunk):
                    _take_chunk(result, record)
                else:
                    _take_record(result, record)
            except _DAMAGE as error:
                raise LogError(f"{result.path}: damaged ({type(error).__name__}: {error})") from error
        result.size += end - offset
        offset = end
    return offset


def _take_chunk(result: Scan, chunk: Chunk) -> None:
    """Add a complete chunk, or raise one of _DAMAGE and add nothing.

    Raises LogError beyond a bound of the whole file.
    """
    data = _data_of(chunk)
    _check_amount(result, LOG_CONTENT, result.content_bytes + len(data))
    messages: list[Entry] = []
    channels, head = result.channels, _MESSAGE.size
    most = LOG_MESSAGES.limit_of(result.size) - len(result.messages)
    per_us = file_units_per_us(result.metadata.get(PROVENANCE, {}))
    for opcode, start, end in _records(data):
        if opcode == Opcode.MESSAGE:
            if end - start < head:
                raise ValueError("a message shorter than its header")
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            if channel_id not in channels:
                raise ValueError(f"a message of channel {channel_id}, which is not declared")
            body = data[start + head : end]
            messages.append(Entry(channel_id, sequence, log_time // per_us, publish_time // per_us, body))
            if len(messages) > most:
                break
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _take_record(result, _framed_record(data[start - _RECORD.size : end]))
    _check_amount(result, LOG_MESSAGES, len(result.messages) + len(messages))
    result.messages.extend(messages)
    result.chunks += 1
    result.content_bytes += len(data)


def _check_amount(result: Scan, bound: Bound, amount: int) -> None:
    """Raise LogError if so much is beyond the bound for this file."""
    limit = bound.limit_of(result.size)
    if amount > limit:
        raise LogError(f"{result.path}: {bound.problem(limit=limit)}")


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the opcode of every record inside a chunk, and the start and end of its body."""
    size, offset = len(data), 0
    while offset < size:
        opcode, length = _RECORD.unpack_from(data, offset)
        start = offset + _RECORD.size
        offset = start + length
        if offset > size:
            raise ValueError("a record longer than its chunk")
        yield opcode, start, offset
