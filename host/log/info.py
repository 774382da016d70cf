"""What a log holds, in few lines for people and one object for machines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from trimtab.host.log import link_report
from trimtab.host.log.flight import scan_closed, to_flight
from trimtab.host.log.topics import MOCAP_POSE
from trimtab.host.log.tracks import FAILSAFE_WORDS


def describe(path: Path) -> dict[str, Any]:
    """Return the answer of `trimtab log info --json`. Raises LogError (exit code 5)."""
    found = scan_closed(path)
    flight = to_flight(found)
    topics: dict[str, Any] = {}
    for topic, entries in sorted(found.by_topic().items()):
        span_s = (entries[-1].log_time_us - entries[0].log_time_us) * 1e-6 if entries else 0.0
        topics[topic] = {
            "messages": len(entries),
            "rate_hz": round((len(entries) - 1) / span_s, 2) if span_s > 0.0 else None,
        }
    for channel in found.channels.values():
        topics[channel.topic]["sampling"] = channel.metadata.get("sampling")
    tracking = flight.tracking
    return {
        "log": found.path.name,
        "id": found.id,
        "kind": flight.kind,
        "bytes": found.size,
        "duration_s": flight.duration_s,
        "vehicle": {"name": flight.vehicle.name, "id": flight.vehicle.id},
        "reference": flight.reference_id,
        "tracking_s": None if tracking is None else [tracking[0] * 1e-6, tracking[1] * 1e-6],
        "tracking_whole": flight.tracking_whole,
        "failsafe": flight.failsafe,
        "link": link_report.link_report(flight) if flight.kind == "flight" else None,
        "recovered": "recovery" in found.metadata,
        "topics": topics,
        "provenance": dict(flight.metadata),
    }


def to_lines(told: dict[str, Any]) -> list[str]:
    """Return the same for people."""
    vehicle, size_kib = told["vehicle"], told["bytes"] / 1024
    lines = [
        f"{told['log']}  id {told['id']}  {size_kib:.0f} KiB  {told['duration_s']:.2f} s  {told['kind']}",
        f"vehicle {vehicle['name']} ({vehicle['id']}), reference {told['reference'] or 'none'}",
    ]
    tracking = told["tracking_s"]
    if tracking is None:
        lines.append("no tracking phase")
    else:
        whole = "" if told["tracking_whole"] else ", cut short"
        lines.append(f"tracking from {tracking[0]:.2f} to {tracking[1]:.2f} s{whole}")
    if told["failsafe"]:
        lines.append(f"ended by failsafe: {FAILSAFE_WORDS.get(told['failsafe'], told['failsafe'])}")
    if told["link"] is not None:
        lines += link_report.to_lines(told["link"])
    if told["recovered"]:
        lines.append("recovered from a damaged file")
    width = max(len(topic) for topic in told["topics"])
    for topic, row in told["topics"].items():
        rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:8.1f} Hz"
        lines.append(f"  {topic:<{width}}  {row['messages']:>7}  {rate:>11}  {row['sampling']}")
    if told["topics"].get(MOCAP_POSE, {}).get("messages") == 0:
        lines.append("no poses arrived")
    return lines
