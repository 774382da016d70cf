"""What a log file holds, record by record, as far as it is whole.

The file is read from its start to its end once, which works alike for closed files and for those whose
writer was killed. Chunks are taken apart here and not by the mcap package, whose general reader is slower.
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

from trimtab.host.log.errors import LogError
from trimtab.host.log.mcap_file import MAGIC
from trimtab.host.log.writer import partial_path

CHUNK_LIMIT_BYTES = 64 * 2**20
"""No chunk of ours comes near this; a length beyond it is damage, not data."""

_DAMAGE = (
    McapError,  # EndOfFile, InvalidMagic, RecordLengthLimitExceeded
    struct.error,
    OverflowError,
    ValueError,  # a failed CRC, text that is no UTF-8
    zstandard.ZstdError,
    MemoryError,
)
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


class Entry(NamedTuple):
    """One message: channel, sequence number, both times in us from arm, protobuf bytes."""

    channel_id: int
    sequence: int
    log_time_us: int
    publish_time_us: int
    data: bytes


@dataclass(kw_only=True)
class Scan:
    """Everything whole in a file: schemas and channels by number, messages in file order, provenance.

    `whole` says that the file was closed by its writer and nothing in it is damaged; otherwise `damage` says
    what is wrong first. `chunks` counts those that are whole; a damaged one is left out.
    """

    path: Path
    id: str
    size: int
    whole: bool = False
    damage: str = ""
    chunks: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Entry] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, tuple[str, bytes]] = field(default_factory=dict)

    def by_topic(self) -> dict[str, list[Entry]]:
        """Return the messages of every topic that has a channel, in file order."""
        topics: dict[str, list[Entry]] = {channel.topic: [] for channel in self.channels.values()}
        names = {number: channel.topic for number, channel in self.channels.items()}
        for message in self.messages:
            topics[names[message.channel_id]].append(message)
        return topics


def find_damaged(path: Path) -> Path:
    """`path`, or the unfinished file beside it where a killed writer left only that."""
    partial = partial_path(path)
    return partial if not path.exists() and partial.exists() else path


def scan(path: Path) -> Scan:
    """All that is whole in the file at `path`, closed or cut.

    Raises LogError where there is no such file or it is no MCAP file at all.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror or error}); check the path") from error
    if not content.startswith(MAGIC):
        what = "is empty" if not content else "is no MCAP file"
        raise LogError(f"{path}: {what}; give a flight log written by trimtab fly or trimtab import")
    result = Scan(path=path, id=hashlib.sha256(content).hexdigest()[:12], size=len(content))
    reader = StreamReader(
        BytesIO(content), emit_chunks=True, record_size_limit=min(len(content), CHUNK_LIMIT_BYTES)
    )
    chunks: list[Chunk] = []
    wrong: list[BaseException] = []
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                chunks.append(record)  # taken apart last: the summary declares its channels too
            else:
                _take_record(result, record)
    except _DAMAGE as error:
        wrong.append(error)
    for chunk in chunks:
        try:
            _take_chunk(result, chunk)
        except _DAMAGE as error:
            wrong.append(error)
    if wrong:
        left_out = len(chunks) - result.chunks
        result.whole = False
        result.damage = f"{type(wrong[0]).__name__}, {result.chunks} whole chunks" + (
            f", {left_out} damaged" if left_out else ""
        )
    return result


def _take_record(result: Scan, record: object) -> None:
    """Add a record of the file or of a chunk, if it is of a kind that is kept."""
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
    if chunk.uncompressed_size > CHUNK_LIMIT_BYTES:
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


def _take_chunk(result: Scan, chunk: Chunk) -> None:
    """Add one chunk whole, or raise one of _DAMAGE and add nothing."""
    data = _data_of(chunk)
    messages: list[Entry] = []
    channels, head = result.channels, _MESSAGE.size
    for opcode, start, end in _records(data):
        if opcode == Opcode.MESSAGE:
            if end - start < head:
                raise ValueError("a message shorter than its head")
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
            if channel_id not in channels:
                raise ValueError(f"a message of channel {channel_id}, which nothing declares")
            messages.append(Entry(channel_id, sequence, log_time, publish_time, data[start + head : end]))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            # StreamReader reads these two from bytes framed like a file without its magic.
            framed = data[start - _RECORD.size : end]
            _take_record(result, next(iter(StreamReader(BytesIO(framed), skip_magic=True).records)))
    result.messages.extend(messages)
    result.chunks += 1


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode of every record inside a chunk, and where its body begins and ends."""
    size, offset = len(data), 0
    while offset < size:
        opcode, length = _RECORD.unpack_from(data, offset)
        start = offset + _RECORD.size
        offset = start + length
        if offset > size:
            raise ValueError("a record longer than its chunk")
        yield opcode, start, offset
