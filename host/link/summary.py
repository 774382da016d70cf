"""Summary of a flight: tracking error, motor saturation and link quality, as text and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from trimtab.host.base.card import card, table
from trimtab.host.link.drivers import DriveStatistics
from trimtab.host.link.flight_request import FlightEnd
from trimtab.host.log import Flight, control_report, link_report, read_flight, topics
from trimtab.host.log.provenance import is_simulated
from trimtab.host.log.tracking import feedforward_faded_s, tracking_error
from trimtab.host.route.clearance import Passed


@dataclass(frozen=True, kw_only=True)
class FlightResult:
    """Result of one flight. A value that could not be measured is None.

    Attributes
    ----------
    log, log_id
        Path of the flight log, and the first 12 hex digits of its SHA-256.
    reference
        Id of the reference flown.
    end
        How the flight ended; None if the host stopped following it before.
    tracking_rmse_m, tracking_max_m
        Distance between camera poses and reference in the tracking phase, m: root mean square and greatest.
    clipped_share
        Share of the ticks in flight on which the motor commands were saturated.
    feedforward_faded_s
        How long the feed-forward was faded beyond its region, s; None without one.
    realtime_factor
        Simulated time over wall time.
    link
        Quality of the link: keys as in `trimtab fly --json`.
    control
        Steps of a controller on the host; None if none flew.
    duration_s
        Duration of the log, s.
    clearance
        Distance to each gate and keep-out shape of the route, m, if the plan's file beside the reference
        names any.
    simulated
        Whether the vehicle was simulated; None if the log does not tell.
    """

    log: Path
    log_id: str
    reference: str
    end: FlightEnd | None
    tracking_rmse_m: float | None
    tracking_max_m: float | None
    clipped_share: float | None
    feedforward_faded_s: float | None
    realtime_factor: float
    link: Mapping[str, Any]
    control: Mapping[str, Any] | None
    duration_s: float
    clearance: tuple[Passed, ...] = ()
    simulated: bool | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the object that `trimtab fly --json` prints, as plain data."""
        return {
            "log": str(self.log),
            "reference": self.reference,
            "tracking_rmse_m": self.tracking_rmse_m,
            "tracking_max_m": self.tracking_max_m,
            "clipped_share": self.clipped_share,
            "feedforward_faded_s": self.feedforward_faded_s,
            "realtime_factor": round(self.realtime_factor, 3),
            "link": dict(self.link),
            "log_id": self.log_id,
            "duration_s": self.duration_s,
            "whole": self.end is not None and self.end.whole,
            "failsafe": None if self.end is None else self.end.failsafe,
            "interrupted": self.end is None or self.end.interrupted,
            "swap": None if self.end is None or self.end.swap is None else self.end.swap.to_json(),
            "takeover": self._takeover_json(),
            "control": self._control_json(),
            "doubt": None if self.end is None or self.end.doubt is None else str(self.end.doubt),
            "clearance": [asdict(each) for each in self.clearance],
        }

    def _takeover_json(self) -> dict[str, Any] | None:
        takeover = None if self.end is None else self.end.takeover
        return None if takeover is None else takeover.to_json()

    def _control_json(self) -> dict[str, Any] | None:
        if self.control is None:
            return None
        stop = None if self.end is None else self.end.stop
        return {**self.control, "stopped": None if stop is None else str(stop)}

    def _repr_html_(self) -> str:
        def mm(value_m: float | None) -> str | None:
            return None if value_m is None else f"{1e3 * value_m:.1f} mm"

        return card(
            f"Flight {self.log.name}",
            [
                ("tracking error, RMSE", mm(self.tracking_rmse_m)),
                ("tracking error, greatest", mm(self.tracking_max_m)),
                ("saturated share of the flight", self.clipped_share),
                ("duration", f"{self.duration_s:.2f} s"),
                ("flown to its end", self.end is not None and self.end.whole),
                ("ended by failsafe", None if self.end is None else self.end.failsafe),
                ("reference", self.reference),
            ],
            table(
                ("obstacle", "distance, m", "at, s"),
                [(each.obstacle, each.distance_m, each.t_s) for each in self.clearance],
            ),
            badge="simulated" if self.simulated else None,
        )

    def to_lines(self) -> list[str]:
        """Return the lines of text for the terminal."""
        lines = [
            f"{self.log}  id {self.log_id}  {self.duration_s:.1f} s, {self.realtime_factor:.1f} x real time"
        ]
        if self.tracking_rmse_m is not None and self.tracking_max_m is not None:
            rmse_mm, max_mm = 1e3 * self.tracking_rmse_m, 1e3 * self.tracking_max_m
            lines.append(f"tracking error {rmse_mm:.1f} mm RMSE, {max_mm:.1f} mm at most")
        if self.clipped_share:
            lines.append(f"motors at their limits for {100.0 * self.clipped_share:.2f} % of the flight")
        if self.feedforward_faded_s:
            lines.append(f"feed-forward faded for {self.feedforward_faded_s:.1f} s, beyond its region")
        swap = None if self.end is None else self.end.swap
        if swap is not None and swap.happened and swap.upload_s is not None and swap.slots_share is not None:
            lines.append(
                f"{swap.reference} took over at {swap.at_s:.3f} s; sent in {swap.upload_s:.2f} s with "
                f"{100.0 * swap.slots_share:.0f} % of the slots"
            )
        lines += control_report.to_lines(None if self.control is None else dict(self.control))
        lines += link_report.to_lines(dict(self.link))
        return lines + [
            f"{each.obstacle}: {abs(1e3 * each.distance_m):.0f} mm "
            f"{'clear' if each.distance_m >= 0.0 else 'MISSED'} at {each.t_s:.2f} s"
            for each in self.clearance
        ]


def summarise(end: FlightEnd | None, log: Path, driven: DriveStatistics) -> FlightResult:
    """Return the result of a flight whose log is closed. Raises LogError if the log cannot be read back."""
    flight = read_flight(log, leave_out=[topics.FC_CONTROL])  # the result does not use this topic
    error = tracking_error(flight)
    return FlightResult(
        log=log,
        log_id=flight.id,
        reference=flight.reference_id or "",
        end=end,
        tracking_rmse_m=None if error is None else error.rmse_m,
        tracking_max_m=None if error is None else error.max_m,
        clipped_share=_clipped_share(flight),
        feedforward_faded_s=feedforward_faded_s(flight),
        realtime_factor=driven.realtime_factor,
        link=link_report.link_report(flight),
        control=control_report.control_report(flight),
        duration_s=flight.duration_s,
        simulated=is_simulated(flight.metadata),
    )


def _clipped_share(flight: Flight) -> float | None:
    status = flight.status
    if status is None:
        return None
    ticks = int(status.flight_ticks[-1] - status.flight_ticks[0])
    return float(status.saturated_ticks[-1] - status.saturated_ticks[0]) / ticks if ticks > 0 else None
