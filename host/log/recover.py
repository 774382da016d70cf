"""Recovery of a log whose writer was killed or whose file was cut."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.base.artefacts import LOG_SUFFIX, open_atomic
from trimtab.host.base.parts import SUFFIX as PART_SUFFIX
from trimtab.host.base.parts import target_of
from trimtab.host.log.errors import NOT_OURS, LogError, foreign_log
from trimtab.host.log.file_time import NANOSECONDS, TIME_UNIT
from trimtab.host.log.flight import to_flight
from trimtab.host.log.mcap_file import McapFile
from trimtab.host.log.provenance import PROVENANCE
from trimtab.host.log.scan import Scan, scan
from trimtab.host.log.unfinished import check_not_written, find_damaged, unfinished_lines, unfinished_logs

SUFFIX = ".recovered.mcap"


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """Result of a recovery. `output` is None if the file was undamaged and nothing was written."""

    source: Path
    output: Path | None
    messages: int
    chunks: int
    duration_s: float
    damage: str

    def to_json(self) -> dict[str, Any]:
        """Return the answer of `trimtab log recover --json`."""
        return {
            "log": str(self.output or self.source),
            "recovered": self.output is not None,
            "messages": self.messages,
            "chunks": self.chunks,
            "duration_s": self.duration_s,
            "damage": self.damage,
        }


def default_output(path: Path) -> Path:
    """Return the default path of the recovered log: FLIGHT.recovered.mcap beside the damaged one."""
    log = target_of(path)
    number = "" if log == path else path.name.removeprefix(log.name).removesuffix(PART_SUFFIX)
    return log.with_name(log.name.removesuffix(LOG_SUFFIX) + number + SUFFIX)


def recover(path: Path, output: Path | None = None, *, force: bool = False) -> Recovery:
    """Write every whole chunk of the file at `path`, with its provenance, to `output`.

    The file at `path` stays as it is. `output` appears whole or not at all. Raises LogError if the file has
    no whole chunk, if its chunks make no flight, or if it is still being written; UsageError if `output`
    exists and `force` is not set.
    """
    if path.is_dir() and (unfinished := unfinished_logs(path)):
        raise LogError("; ".join([f"{path}: is a folder; give a log", *unfinished_lines(unfinished)]))
    source = find_damaged(path)
    check_not_written(source)
    records = scan(source)
    if records.is_foreign:
        raise foreign_log(source, NOT_OURS)
    times = [message.log_time_us for message in records.messages]
    target = None
    if not records.whole:
        if not times or PROVENANCE not in records.metadata:
            raise LogError(
                f"{source}: cut before the end of its first chunk, nothing can be recovered; fly again"
            )
        to_flight(records)
        target = output or default_output(source)
        _write_atomic(records, target, force)
    return Recovery(
        source=source,
        output=target,
        messages=len(times),
        chunks=records.chunks,
        duration_s=(max(times) - min(times)) * 1e-6 if times else 0.0,
        damage="" if records.whole else records.damage,
    )


def _write_atomic(records: Scan, target: Path, force: bool) -> None:
    """Write the records to `target`, whole or not at all. Raises LogError and UsageError."""
    try:
        with open_atomic(target, force) as stream:
            _write(records, McapFile(stream))
    except OSError as error:
        raise LogError(f"{target}: cannot be written ({error.strerror}); give another -o") from error


def _write(records: Scan, writer: McapFile) -> None:
    """Write the records and a description of the recovery to an MCAP file."""
    for name, entries in records.metadata.items():
        unit = {TIME_UNIT: NANOSECONDS} if name == PROVENANCE else {}
        writer.add_metadata(name, {**entries, **unit})
    writer.add_metadata("recovery", {"damage": records.damage, "bytes": str(records.size)})
    for name, (media_type, data) in records.attachments.items():
        writer.add_attachment(name, media_type, data)
    schemas = {
        number: writer.add_schema(schema.name, schema.data, schema.encoding)
        for number, schema in records.schemas.items()
    }
    channels = {
        number: writer.add_channel(
            channel.topic,
            schemas.get(channel.schema_id, 0),
            {key: value for key, value in channel.metadata.items() if key != TIME_UNIT},
            channel.message_encoding,
        )
        for number, channel in records.channels.items()
    }
    for entry in records.messages:
        writer.add_message(
            channels[entry.channel_id], entry.log_time_us, entry.publish_time_us, entry.data, entry.sequence
        )
    writer.finish()
