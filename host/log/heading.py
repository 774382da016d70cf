"""The heading of a flight log: its id and metadata, without its messages."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import cast

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from trimtab.host.base.artefacts import content_id
from trimtab.host.log.errors import NOT_OURS, LogError, foreign_log, unreadable
from trimtab.host.log.mcap_file import MAGIC
from trimtab.host.log.provenance import PROVENANCE

_RECORD = struct.Struct("<BQ")


@dataclass(frozen=True, kw_only=True)
class Heading:
    """Id of a log, and its metadata, by the name of the record."""

    id: str
    metadata: Mapping[str, Mapping[str, str]]


def read_heading(path: Path) -> Heading:
    """Return the heading of the log at `path`.

    The whole file is read for its id, but no message is decoded. Raises LogError for a file that cannot be
    read, is not a log of Trimtab, or was not closed.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from error
    if not content.startswith(MAGIC):
        raise foreign_log(path, "is not an MCAP file")
    if not content.endswith(MAGIC) or len(content) == len(MAGIC):
        raise LogError(f"{path}: ends early; run `trimtab log recover {path}`")
    try:
        metadata = {record.name: record.metadata for record in _metadata_records(content)}
    except (McapError, struct.error, OverflowError, ValueError, MemoryError) as error:
        raise LogError(f"{path}: is damaged; run `trimtab log recover {path}`") from error
    if PROVENANCE not in metadata:
        raise foreign_log(path, NOT_OURS)
    return Heading(id=content_id(content), metadata=metadata)


def _metadata_records(content: bytes) -> Iterator[Metadata]:
    """Yield the metadata records of a file up to the end of its data. Skip all other records unread."""
    offset = len(MAGIC)
    while True:
        opcode, length = _RECORD.unpack_from(content, offset)
        end = offset + _RECORD.size + length
        if end > len(content):
            raise ValueError("a record longer than its file")
        if opcode == Opcode.METADATA:
            framed = StreamReader(BytesIO(content[offset:end]), skip_magic=True)
            yield cast(Metadata, next(iter(framed.records)))
        elif opcode == Opcode.DATA_END:
            return
        offset = end
