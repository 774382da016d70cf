"""Writer for MCAP files: provenance first, then zstd chunks, then the index and footer.

Record types come from the mcap package. This module adds messages to chunks and their index, which happens
hundreds of times a second in flight. The package's own writer takes three times as long.

Callers give times in microseconds. The file holds nanoseconds.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.well_known import MessageEncoding, SchemaEncoding

from trimtab.host.log.file_time import NS_PER_US

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 64 * 1024
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD_BYTES = 22
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_HEAD_BYTES = 6
_FOOTER_HEAD = struct.Struct("<BQQQ")


class Sink(Protocol):
    """Destination of the bytes."""

    def write(self, data: bytes, /) -> object: ...


@dataclass(frozen=True, kw_only=True)
class _Written:
    """Records of the summary section so far."""

    schemas: list[Schema]
    channels: list[Channel]
    chunks: list[ChunkIndex]
    attachments: list[AttachmentIndex]
    metadata: list[MetadataIndex]


class McapFile:
    """An MCAP file that is being written to `sink`.

    Attachments must come before the first message. A full chunk is written in one piece. `counts` holds the
    number of messages of each channel in the chunks written, `chunks` the number of chunks.
    """

    def __init__(self, sink: Sink, library: str = "trimtab") -> None:
        self._sink = sink
        self._size = 0
        self._written = _Written(schemas=[], channels=[], chunks=[], attachments=[], metadata=[])
        self._chunk = bytearray()
        self._index: defaultdict[int, list[int]] = defaultdict(list)  # times and offsets in turn, by channel
        self.counts: dict[int, int] = {}
        self.chunks = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._compressor = zstandard.ZstdCompressor()
        self._put(MAGIC)
        self._put(_bytes(Header(profile="", library=library)))

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record."""
        data = _bytes(Metadata(name=name, metadata=dict(entries)))
        self._written.metadata.append(MetadataIndex(offset=self._size, length=len(data), name=name))
        self._put(data)

    def add_attachment(self, name: str, media_type: str, content: bytes) -> None:
        """Write an attachment, with its times set to 0."""
        record = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content)
        data = _bytes(record)
        self._written.attachments.append(
            AttachmentIndex(
                offset=self._size,
                length=len(data),
                create_time=0,
                log_time=0,
                data_size=len(content),
                name=name,
                media_type=media_type,
            )
        )
        self._put(data)

    def add_schema(self, name: str, descriptor: bytes, encoding: str = SchemaEncoding.Protobuf) -> int:
        """Add a schema to the current chunk. Return its number."""
        number = len(self._written.schemas) + 1
        schema = Schema(id=number, name=name, encoding=encoding, data=descriptor)
        self._written.schemas.append(schema)
        self._chunk += _bytes(schema)
        return number

    def add_channel(
        self,
        topic: str,
        schema: int,
        metadata: Mapping[str, str],
        encoding: str = MessageEncoding.Protobuf,
    ) -> int:
        """Add a channel to the current chunk. Return its number."""
        number = len(self._written.channels) + 1
        channel = Channel(
            id=number, topic=topic, message_encoding=encoding, metadata=dict(metadata), schema_id=schema
        )
        self._written.channels.append(channel)
        self._chunk += _bytes(channel)
        self.counts[number] = 0
        return number

    def add_message(self, channel: int, log_us: int, publish_us: int, data: bytes, sequence: int = 0) -> None:
        """Add a message to the current chunk. Write the chunk if it is full. Times: 0 to LAST_US."""
        chunk, log_ns = self._chunk, NS_PER_US * log_us
        self._index[channel] += (log_ns, len(chunk))
        size, publish_ns = _MESSAGE_HEAD_BYTES + len(data), NS_PER_US * publish_us
        chunk += _MESSAGE.pack(Opcode.MESSAGE, size, channel, sequence, log_ns, publish_ns)
        chunk += data
        if len(chunk) > CHUNK_BYTES:
            self._end_chunk()

    def finish(self) -> None:
        """Write the last chunk, the index and the footer."""
        if self._index:
            self._end_chunk()
        self._put(_bytes(DataEnd(data_section_crc=0)))
        start = self._size
        summary, offsets = self._summary(start)
        offsets_start = start + len(summary)
        summary += b"".join(_bytes(offset) for offset in offsets)
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, 8 + 8 + 4, start, offsets_start)
        crc = zlib.crc32(head, zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc)
        self._put(summary + _bytes(footer) + MAGIC)

    def _summary(self, start: int) -> tuple[bytes, list[SummaryOffset]]:
        """Return the summary section that begins at `start`, and the offset of each of its groups."""
        written = self._written
        statistics = Statistics(
            message_count=sum(self.counts.values()),
            schema_count=len(written.schemas),
            channel_count=len(written.channels),
            attachment_count=len(written.attachments),
            metadata_count=len(written.metadata),
            chunk_count=len(written.chunks),
            message_start_time=self._first_ns or 0,
            message_end_time=self._last_ns,
            channel_message_counts={number: count for number, count in self.counts.items() if count},
        )
        groups: list[tuple[int, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*written.schemas]),
            (Opcode.CHANNEL, [*written.channels]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*written.chunks]),
            (Opcode.ATTACHMENT_INDEX, [*written.attachments]),
            (Opcode.METADATA_INDEX, [*written.metadata]),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            if not records:
                continue
            data = b"".join(map(_bytes, records))
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(data))
            )
            summary += data
        return summary, offsets

    def _end_chunk(self) -> None:
        """Write the current chunk and begin another."""
        raw = bytes(self._chunk)
        packed = self._compressor.compress(raw)
        times = [time for entries in self._index.values() for time in entries[::2]]
        first, last = min(times), max(times)
        chunk = _bytes(
            Chunk(
                compression="zstd",
                data=packed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(raw),
                uncompressed_size=len(raw),
            )
        )
        index, offsets = b"", {}
        for channel, entries in self._index.items():
            self.counts[channel] += len(entries) // 2
            offsets[channel] = self._size + len(chunk) + len(index)
            size = 8 * len(entries)
            head = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, _INDEX_HEAD_BYTES + size, channel, size)
            index += head + struct.pack(f"<{len(entries)}Q", *entries)
        self._written.chunks.append(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=self._size,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=len(index),
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(raw),
            )
        )
        self._put(chunk + index)
        self.chunks += 1
        self._first_ns = first if self._first_ns is None else min(first, self._first_ns)
        self._last_ns = max(last, self._last_ns)
        self._chunk = bytearray()
        self._index.clear()

    def _put(self, data: bytes) -> None:
        self._sink.write(data)
        self._size += len(data)


def _bytes(record: McapRecord) -> bytes:
    """Return the encoded record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
