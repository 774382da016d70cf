"""What the file of a flight holds: its size, and the messages of each topic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trimtab.host.log.scan import Scan


@dataclass(frozen=True, kw_only=True)
class TopicContents:
    """Messages of one topic: their number, mean rate, and whether they are means or samples.

    rate_hz: None for fewer than two times. sampling: None where the file does not say.
    """

    messages: int
    rate_hz: float | None
    sampling: str | None


@dataclass(frozen=True, kw_only=True)
class LogContents:
    """Size of a log's file in bytes, its topics by name, and whether it was recovered."""

    size: int
    topics: Mapping[str, TopicContents]
    recovered: bool

    @classmethod
    def of(cls, records: Scan) -> LogContents:
        """Return it for the records of a file."""
        sampling = {each.topic: each.metadata.get("sampling") for each in records.channels.values()}
        topics = {}
        for topic, entries in sorted(records.by_topic().items()):
            span_s = (entries[-1].log_time_us - entries[0].log_time_us) * 1e-6 if entries else 0.0
            rate_hz = round((len(entries) - 1) / span_s, 2) if span_s > 0.0 else None
            topics[topic] = TopicContents(messages=len(entries), rate_hz=rate_hz, sampling=sampling[topic])
        return cls(size=records.size, topics=topics, recovered="recovery" in records.metadata)
