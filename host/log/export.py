"""A log as tables: one CSV file a topic, one column a number."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from host.log.flight import scan_closed
from host.log.scan import Entry
from host.log.topics import FLIGHT_TOPICS, IMPORTED_TOPICS

_KINDS = {topic.name: topic.message for topic in (*FLIGHT_TOPICS, *IMPORTED_TOPICS)}


def file_name(topic: str) -> str:
    """The name of a topic's table: /fc/control goes to fc-control.csv."""
    return topic.strip("/").replace("/", "-") + ".csv"


def export_csv(log: Path, folder: Path) -> dict[str, int]:
    """Rows by file written into `folder`, which is made where it is missing; topics without messages are
    left out.

    Columns: log_time_us, publish_time_us (from arm), then the message's fields, those with several numbers as
    name_0, name_1, ... Raises LogError where the log cannot be read.
    """
    topics = scan_closed(log).by_topic()
    folder.mkdir(parents=True, exist_ok=True)
    written: dict[str, int] = {}
    for topic, entries in sorted(topics.items()):
        kind = _KINDS.get(topic)
        if kind is None or not entries:
            continue
        name = file_name(topic)
        with (folder / name).open("w", newline="", encoding="utf-8") as file:
            written[name] = _write(csv.writer(file, lineterminator="\n"), entries, kind)
    return written


def _write(table: Any, entries: Sequence[Entry], kind: Any) -> int:
    messages = [kind.FromString(entry.data) for entry in entries]
    widths = {
        field.name: max(len(getattr(message, field.name)) for message in messages)
        for field in kind.DESCRIPTOR.fields
        if field.is_repeated
    }
    table.writerow(["log_time_us", "publish_time_us", *_names(kind.DESCRIPTOR, widths)])
    for entry, message in zip(entries, messages, strict=True):
        table.writerow([entry.log_time_us, entry.publish_time_us, *_values(message, widths)])
    return len(messages)


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
