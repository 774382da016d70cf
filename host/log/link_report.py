"""Report of the link quality during a flight, from its log."""

from __future__ import annotations

from typing import Any

import numpy as np

from trimtab.host.log.one_flight import Flight
from trimtab.host.log.provenance import AUTOPILOT
from trimtab.host.log.tracks import LinkHealth


def link_report(flight: Flight) -> dict[str, Any]:
    """Return the `link` object of `fly` and `log info`. Values that the log does not contain are None.

    Counts and rates cover the time from arming to the end of the log. The age of poses covers the tracking
    phase. Telemetry gaps cover the whole log.
    """
    report = {
        **_radios(flight),
        **_host(flight.link),
        **_poses(flight),
        **_telemetry(flight),
        **_timing(flight),
    }
    if AUTOPILOT in flight.metadata:  # it also sends messages that the host does not read, nor count
        report |= dict.fromkeys(("frames_lost", "messages_lost"))
    return report


def to_lines(report: dict[str, Any]) -> list[str]:
    """Return the lines of text for the terminal, from the object that `link_report` returns."""
    lines = []
    if report["frames_sent"] is not None:
        ways = [
            f"{100.0 * report[f'{way}_lost_share']:.1f} % {way}"
            for way in ("up", "down")
            if report[f"{way}_lost_share"] is not None
        ]
        rtt = "" if report["rtt_ms"] is None else f", round trip {report['rtt_ms']:.1f} ms"
        late = "" if report["rtt_ms_p99"] is None else f" ({report['rtt_ms_p99']:.1f} at 99 %)"
        by_direction = f" ({', '.join(ways)})" if ways else ""
        lost = "" if report["frames_lost"] is None else f", {report['frames_lost']} lost"
        lines.append(f"link: {report['frames_sent']} frames{lost}{by_direction}{rtt}{late}")
    if report["mocap_age_ms_p99"] is not None:
        lines.append(
            f"poses on board {report['mocap_age_ms_p50']:.0f} ms old, "
            f"{report['mocap_age_ms_p99']:.0f} at 99 %, {_shown(report['mocap_age_ms_max'], '.0f')} at most, "
            f"{_shown(report['poses_lost'], 'd')} lost"
        )
    if report["late_s"]:
        worst_ms = report["pose_late_ms_max"]
        lines.append(
            f"time ran late for {report['late_s']:.1f} s: poses arrived up to {worst_ms:.0f} ms late"
        )
    if report["clock_steps"]:
        lines.append(f"the vehicle's clock jumped against the host's: {report['clock_steps']} times")
    trouble = [
        f"{report[key]} {words}"
        for key, words in (
            ("refused", "messages refused by full queues"),
            ("broken", "long messages broken"),
            ("overruns", "bytes overrun"),
            ("bad_bytes", "bytes damaged"),
        )
        if report[key]
    ]
    if trouble:
        lines.append("link: " + ", ".join(trouble))
    return lines


def _shown(value: float | None, form: str) -> str:
    return "?" if value is None else format(value, form)


def _radios(flight: Flight) -> dict[str, Any]:
    link = flight.link
    radios = None if link is None else link.radios
    report: dict[str, Any] = {}
    for way in ("up", "down"):
        sent = None if radios is None else radios[f"{way}_sent"]
        # Accurate to a few frames: a frame in the air looks like a loss.
        lost = None if radios is None or sent is None else max(0, sent - radios[f"{way}_received"])
        share = lost / sent if sent and lost is not None else None
        report |= {f"{way}_sent": sent, f"{way}_lost": lost, f"{way}_lost_share": share}
    for name in ("refused", "replaced", "broken"):
        report[name] = None if radios is None else radios[name]
    status = flight.status
    on_board = None if status is None else status.receive_overruns
    report["overruns"] = _sum(None if radios is None else radios["overruns"], on_board)
    bad = _sum(None if radios is None else radios["bad_bytes"], None if status is None else status.bad_bytes)
    report["bad_bytes"] = bad if link is None else (bad or 0) + _increase(link.bad_bytes)
    return report


def _sum(of_radios: int | None, on_board: Any) -> int | None:
    parts = [] if of_radios is None else [of_radios]
    parts += [] if on_board is None else [_increase(on_board)]
    return sum(parts) if parts else None


def _increase(counter: Any) -> int:
    """Return the increase of a counter over the log."""
    return int(counter[-1] - counter[0])


def _host(link: LinkHealth | None) -> dict[str, Any]:
    names = ("messages_sent", "messages_received", "messages_lost")
    if link is None:
        keys = ("frames_sent", "frames_lost", *names, "messages_repeated", "bytes_up_s", "bytes_down_s")
        return dict.fromkeys((*keys, "rtt_ms", "rtt_ms_p99", "clock_sd_ms"))
    span_s = (link.t_us[-1] - link.t_us[0]) * 1e-6
    rtts_us = link.rtt_last_us[link.rtt_last_us > 0.0]
    if not len(rtts_us):  # older logs hold only the smoothed round trip
        rtts_us = link.rtt_us[link.rtt_us > 0.0]
    return {
        "frames_sent": int(link.frames_sent[-1]),
        "frames_lost": int(link.frames_lost[-1]),
        **{name: _increase(getattr(link, name)) for name in names},
        "messages_repeated": _increase(link.frames_repeated),
        "bytes_up_s": _increase(link.bytes_sent) / span_s if span_s > 0.0 else None,
        "bytes_down_s": _increase(link.bytes_received) / span_s if span_s > 0.0 else None,
        "rtt_ms": float(np.median(rtts_us)) * 1e-3 if len(rtts_us) else None,
        "rtt_ms_p99": float(np.percentile(rtts_us, 99.0)) * 1e-3 if len(rtts_us) else None,
        "clock_sd_ms": float(np.median(link.clock_offset_sd_us)) * 1e-3,
    }


def _poses(flight: Flight) -> dict[str, Any]:
    report: dict[str, Any] = dict.fromkeys(
        ("mocap_age_ms_p50", "mocap_age_ms_p99", "mocap_age_ms_max", "poses_lost")
    )
    estimate, status, mocap = flight.estimate, flight.status, flight.mocap
    if flight.tracking is not None:
        start_us, end_us = flight.tracking
        oldest_ms = 0.0
        if estimate is not None:
            keep = (estimate.t_us >= start_us) & (estimate.t_us <= end_us)
            if keep.any() and estimate.mocap_age_s.any():  # another autopilot's estimates have no age
                ages_ms = estimate.mocap_age_s[keep] * 1e3
                report["mocap_age_ms_p50"], report["mocap_age_ms_p99"] = np.percentile(
                    ages_ms, (50.0, 99.0)
                ).tolist()
                oldest_ms = float(ages_ms.max())
        if status is not None:
            # A status covers the time since the previous one, which may have been lost.
            ages_us = status.mocap_age_max_us[(status.t_us > start_us) & (status.t_us <= end_us)]
            if len(ages_us) and ages_us.max():
                report["mocap_age_ms_max"] = max(float(ages_us.max()) * 1e-3, oldest_ms)
    if status is not None and mocap is not None and len(status.t_us) > 1:
        # Poses in transit at both ends cancel, except for a few that arrive late.
        sent = np.count_nonzero((mocap.t_us > status.t_us[0]) & (mocap.t_us <= status.t_us[-1]))
        report["poses_lost"] = max(0, int(sent) - _increase(status.poses_used))
    return report


def _timing(flight: Flight) -> dict[str, Any]:
    """Return how late poses arrived in real time. The values are None for a flight in lock-step."""
    timing = flight.timing
    if timing is None:
        return dict.fromkeys(("late_s", "poses_late", "pose_late_ms_max", "clock_steps"))
    return {
        "late_s": float(np.diff(timing.t_us, prepend=0)[timing.runs_late].sum()) * 1e-6,
        "poses_late": int(timing.late_poses.sum()),
        "pose_late_ms_max": float(timing.pose_late_us.max()) * 1e-3,
        "clock_steps": _increase(timing.clock_steps),
    }


def _telemetry(flight: Flight) -> dict[str, Any]:
    estimate = flight.estimate
    gaps = None if estimate is None or len(estimate.t_us) < 2 else np.diff(estimate.t_us)
    return {"telemetry_gap_ms": None if gaps is None else float(gaps.max()) * 1e-3}
