"""Export of a log as tables: one CSV file for each topic, one column for each number."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from trimtab.host.log.flight import scan_closed
from trimtab.host.log.scan import Entry
from trimtab.host.log.topics import CONTROLLED_TOPICS, DISPLAY_PREFIX, IMPORTED_TOPICS, TIMING_TOPICS

_KINDS = {
    topic.name: topic.message
    for topic in (*CONTROLLED_TOPICS, *TIMING_TOPICS, *IMPORTED_TOPICS)
    if not topic.name.startswith(DISPLAY_PREFIX)
}


def file_name(topic: str) -> str:
    """Return the file name of a topic's table, for instance fc-control.csv for /fc/control."""
    return topic.strip("/").replace("/", "-") + ".csv"


TABLES = tuple(sorted(map(file_name, _KINDS)))
"""Names of all possible tables."""


def csv_tables(log: Path) -> dict[str, tuple[int, str]]:
    """Return (number of rows, text) by file name, without topics for viewers and topics without messages.

    The columns are log_time_us, publish_time_us (from arm), then the fields of the message. A field with
    several numbers has the columns name_0, name_1, ... Raises LogError if the log cannot be read.
    """
    return {
        file_name(topic): (len(entries), _table(entries, _KINDS[topic]))
        for topic, entries in sorted(scan_closed(log).by_topic().items())
        if topic in _KINDS and entries
    }


def _table(entries: Sequence[Entry], kind: Any) -> str:
    messages = [kind.FromString(entry.data) for entry in entries]
    widths = {
        field.name: max(len(getattr(message, field.name)) for message in messages)
        for field in kind.DESCRIPTOR.fields
        if field.is_repeated
    }
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["log_time_us", "publish_time_us", *_names(kind.DESCRIPTOR, widths)])
    for entry, message in zip(entries, messages, strict=True):
        table.writerow([entry.log_time_us, entry.publish_time_us, *_values(message, widths)])
    return text.getvalue()


def _names(descriptor: Any, widths: dict[str, int], prefix: str = "") -> Iterator[str]:
    for field in descriptor.fields:
        if field.is_repeated:
            yield from (f"{prefix}{field.name}_{k}" for k in range(widths[field.name]))
        elif field.message_type is not None:
            yield from _names(field.message_type, widths, f"{prefix}{field.name}_")
        else:
            yield f"{prefix}{field.name}"


def _values(message: Any, widths: dict[str, int]) -> Iterator[Any]:
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.is_repeated:
            yield from value
            yield from [""] * (widths[field.name] - len(value))
        elif field.message_type is not None:
            yield from _values(value, widths)
        elif field.enum_type is not None:
            yield field.enum_type.values_by_number[value].name
        else:
            yield value
