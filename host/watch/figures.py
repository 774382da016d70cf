"""The figures of a running flight, from the messages of its log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trimtab.host.log import FAILSAFE_WORDS, failsafe_name, topics
from trimtab.host.log.scan import Entry
from trimtab.protocol.generated import flight_pb2

_KINDS: dict[str, Any] = {
    topics.MOCAP_POSE: flight_pb2.MocapPose,
    topics.REFERENCE: flight_pb2.Reference,
    topics.FC_ESTIMATE: flight_pb2.Estimate,
    topics.FC_STATUS: flight_pb2.Status,
    topics.LINK: flight_pb2.Link,
}


class Figures:
    """Newest values and greatest tracking error of a flight. What is not known yet is None."""

    def __init__(self) -> None:
        self._time_us = 0
        self._newest: dict[str, Any] = {}
        self._reference: list[tuple[int, list[float]]] = []
        self._error_m: float | None = None
        self._error_max_m: float | None = None

    def add(self, messages: Sequence[Entry], topic_of: Mapping[int, str]) -> None:
        """Take the next messages. topic_of: topic of each channel."""
        poses: list[tuple[int, list[float]]] = []
        for entry in messages:
            topic = topic_of[entry.channel_id]
            self._time_us = max(self._time_us, entry.log_time_us)
            if topic not in _KINDS:
                continue
            message = self._newest[topic] = _KINDS[topic].FromString(entry.data)
            if topic == topics.MOCAP_POSE:
                poses.append((entry.publish_time_us, list(message.p_ned_m)))
            elif topic == topics.REFERENCE:
                self._reference.append((entry.publish_time_us, list(message.p_ned_m)))
        self._track(poses)

    def _track(self, poses: Sequence[tuple[int, list[float]]]) -> None:
        """Compare poses with the reference at their times, linear between two of its rows."""
        if not self._reference or not poses:
            return
        at_us, reference = (
            np.array([t for t, _ in self._reference]),
            np.array([p for _, p in self._reference]),
        )
        t_us, p = np.array([t for t, _ in poses]), np.array([p for _, p in poses])
        inside = (t_us >= at_us[0]) & (t_us <= at_us[-1])
        if inside.any():
            expected = np.stack([np.interp(t_us[inside], at_us, column) for column in reference.T], axis=1)
            errors = np.linalg.norm(p[inside] - expected, axis=1)
            self._error_m = float(errors[-1])
            self._error_max_m = max(float(errors.max()), self._error_max_m or 0.0)
        del self._reference[:-2]

    def to_json(self) -> dict[str, Any]:
        """Return the figures as `trimtab watch --json` prints them."""
        status, estimate = self._newest.get(topics.FC_STATUS), self._newest.get(topics.FC_ESTIMATE)
        link = self._newest.get(topics.LINK)
        return {
            "time_s": self._time_us * 1e-6,
            "phase": None if status is None else flight_pb2.Status.State.Name(status.state).lower(),
            "failsafe": None if status is None else failsafe_name(status.failsafe),
            # 0: not known, of another autopilot
            "pose_age_ms": None if estimate is None else estimate.mocap_age_us * 1e-3 or None,
            "error_m": self._error_m,
            "error_max_m": self._error_max_m,
            "battery_v": None if status is None else status.battery_v,
            "rtt_ms": None if link is None else link.rtt_us * 1e-3,
            "frames_lost_share": None
            if not (link and link.frames_sent)
            else link.frames_lost / link.frames_sent,
        }


def to_rows(figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and value of each figure as text, from the object of `Figures.to_json`."""

    def text(name: str, form: str, factor: float = 1.0) -> str:
        return "-" if figures[name] is None else form.format(factor * figures[name])

    failsafe: str | None = figures["failsafe"]
    return [
        ("time from arm", text("time_s", "{:.1f} s")),
        ("phase", figures["phase"] or "-"),
        ("failsafe", "none" if failsafe is None else FAILSAFE_WORDS.get(failsafe, failsafe)),
        ("age of the pose on board", text("pose_age_ms", "{:.0f} ms")),
        ("tracking error", text("error_m", "{:.1f} mm", 1e3)),
        ("greatest tracking error", text("error_max_m", "{:.1f} mm", 1e3)),
        ("battery", text("battery_v", "{:.2f} V")),
        ("round trip", text("rtt_ms", "{:.1f} ms")),
        ("frames lost", text("frames_lost_share", "{:.1f} %", 1e2)),
    ]
