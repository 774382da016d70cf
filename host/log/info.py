"""Description of a log, as lines of text and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from trimtab.host.base.card import card, table
from trimtab.host.log import control_report, link_report
from trimtab.host.log.one_flight import Flight
from trimtab.host.log.provenance import is_simulated
from trimtab.host.log.rebuilt import Rebuilt
from trimtab.host.log.topics import MOCAP_POSE
from trimtab.host.log.tracking import feedforward_faded_s
from trimtab.host.log.tracks import FAILSAFE_WORDS


def describe(flight: Flight) -> dict[str, Any]:
    """Return what a log holds, as plain data: `Flight.to_dict`."""
    contents, tracking = flight.contents, flight.tracking
    return {
        "log": flight.path.name,
        "id": flight.id,
        "kind": flight.kind,
        "bytes": contents.size,
        "duration_s": flight.duration_s,
        "vehicle": {"name": flight.vehicle.name, "id": flight.vehicle.id},
        "reference": flight.reference_id,
        "feedforward": None if flight.feedforward is None else flight.feedforward.id,
        "feedforward_faded_s": feedforward_faded_s(flight),
        "tracking_s": None if tracking is None else [tracking[0] * 1e-6, tracking[1] * 1e-6],
        "unused_s": [[a * 1e-6, b * 1e-6] for a, b in flight.unused],
        "rebuilt": None if flight.rebuilt is None else asdict(flight.rebuilt),
        "tracking_whole": flight.tracking_whole,
        "failsafe": flight.failsafe,
        "link": link_report.link_report(flight) if flight.kind == "flight" else None,
        "control": control_report.control_report(flight),
        "recovered": contents.recovered,
        "topics": {name: asdict(topic) for name, topic in contents.topics.items()},
        "provenance": dict(flight.metadata),
    }


def to_lines(info: dict[str, Any]) -> list[str]:
    """Return the lines of text for the terminal, from `Flight.to_dict`."""
    vehicle, size_kib = info["vehicle"], info["bytes"] / 1024
    lines = [
        f"{info['log']}  id {info['id']}  {size_kib:.0f} KiB  {info['duration_s']:.2f} s  {info['kind']}",
        f"vehicle {vehicle['name']} ({vehicle['id']}), reference {info['reference'] or 'none'}",
    ]
    tracking = info["tracking_s"]
    if tracking is None:
        lines.append("no tracking phase")
    else:
        whole = "" if info["tracking_whole"] else ", cut short"
        lines.append(f"tracking from {tracking[0]:.2f} to {tracking[1]:.2f} s{whole}")
    lines += [f"not used from {a:.2f} to {b:.2f} s" for a, b in info["unused_s"]]
    if info["rebuilt"] is not None:
        lines.append(f"rebuilt by the import: {Rebuilt(**info['rebuilt'])}")
    if info["feedforward"] is not None:
        faded_s = info["feedforward_faded_s"]
        faded = f", faded for {faded_s:.1f} s beyond its region" if faded_s else ""
        lines.append(f"feed-forward {info['feedforward']}{faded}")
    if info["failsafe"]:
        lines.append(f"ended by failsafe: {FAILSAFE_WORDS.get(info['failsafe'], info['failsafe'])}")
    lines += control_report.to_lines(info["control"])
    if info["link"] is not None:
        lines += link_report.to_lines(info["link"])
    if info["recovered"]:
        lines.append("recovered from a damaged file")
    width = max(len(topic) for topic in info["topics"])
    for topic, row in info["topics"].items():
        rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:8.1f} Hz"
        lines.append(f"  {topic:<{width}}  {row['messages']:>7}  {rate:>11}  {row['sampling']}")
    if info["topics"].get(MOCAP_POSE, {}).get("messages") == 0:
        lines.append("no poses arrived")
    return lines


def flight_card(flight: Flight) -> str:
    """Return the HTML card of a flight for notebooks."""
    tracking = flight.tracking
    interval = None if tracking is None else f"{tracking[0] * 1e-6:.2f} to {tracking[1] * 1e-6:.2f} s"
    return card(
        f"{'Flight' if flight.kind == 'flight' else 'Imported flight'} {flight.path.name}",
        [
            ("id", flight.id),
            ("vehicle", flight.vehicle.name),
            ("reference", flight.reference_id),
            ("duration", f"{flight.duration_s:.2f} s"),
            ("tracking", interval),
            ("flown to its end", flight.tracking_whole if flight.kind == "flight" else None),
            ("ended by failsafe", flight.failsafe),
        ],
        table(
            ("topic", "messages", "rate, Hz"),
            [(name, topic.messages, topic.rate_hz) for name, topic in flight.contents.topics.items()],
        ),
        badge="simulated" if is_simulated(flight.metadata) else None,
    )
