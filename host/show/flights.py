"""Flights as tracks and facts of a page. A cut log shows its intact part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from trimtab.host.log import Flight, LogError
from trimtab.host.log.errors import NOT_OURS, foreign_log
from trimtab.host.log.events import Event, read_events
from trimtab.host.log.flight import to_flight
from trimtab.host.log.provenance import PROVENANCE, VEHICLE_FILE, is_simulated
from trimtab.host.log.scan import scan
from trimtab.host.log.tracking import reference_at, tracking_errors_ned, within
from trimtab.host.log.tracks import FAILSAFE_WORDS, Floats, Times
from trimtab.host.log.unfinished import find_damaged
from trimtab.host.show.lattice import Track, attitudes, euler_deg, lattice, peaks, sampled, wrapped_deg

UP = np.array([1.0, 1.0, -1.0])
"""Signs that turn NED into north, east, up, in which a page shows positions and velocities."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShownFlight:
    """A flight with its events. damage: why its log is not whole, else None."""

    flight: Flight
    events: tuple[Event, ...]
    damage: str | None

    @property
    def zero_us(self) -> int:
        """Time 0 on the page, us on the flight's clock: start of tracking, else that of the clock."""
        return self.flight.tracking[0] if self.flight.tracking else 0

    @property
    def span_us(self) -> tuple[int, int]:
        """Time of the first and the last sample, us on the flight's clock."""
        tracks = (self.flight.mocap, self.flight.estimate, self.flight.status, self.flight.recorded_inputs)
        times = [track.t_us for track in tracks if track is not None]
        if not times:
            return 0, 0
        return int(min(t[0] for t in times)), int(max(t[-1] for t in times))


def read_shown(path: Path) -> ShownFlight:
    """Return the flight of a log, whole or cut.

    Raises LogError if the file is no log of Trimtab, or if it was cut before anything that describes the
    flight.
    """
    records = scan(find_damaged(path))
    if PROVENANCE not in records.metadata or VEHICLE_FILE not in records.attachments:
        if records.whole or records.is_foreign:
            raise foreign_log(records.path, NOT_OURS)
        raise LogError(f"{records.path}: cut before the vehicle file, nothing can be shown; fly again")
    flight = to_flight(records)
    return ShownFlight(
        flight=flight, events=read_events(records, flight), damage=None if records.whole else records.damage
    )


def flight_track(shown: ShownFlight, name: str, step_us: int) -> Track:
    """Return a flight on the lattice."""
    flight, zero_us = shown.flight, shown.zero_us
    start_us, end_us = shown.span_us
    grid_us = lattice(start_us - zero_us, end_us - zero_us, step_us)
    at_us = grid_us + zero_us
    channels: dict[str, Any] = {}
    _add_motion(channels, flight, at_us)
    _add_reference(channels, flight, at_us)
    _add_control(channels, flight, at_us)
    error = tracking_rows(flight)
    if error is not None:
        channels["error"] = peaks(at_us, error[0], 1e3 * np.linalg.norm(error[1], axis=1))
        channels["error"][~within(at_us, flight.tracking or shown.span_us)] = np.nan
    return Track(
        name=name,
        what="import" if flight.kind == "imported" else "flight",
        simulated=bool(is_simulated(flight.metadata)),
        reference_id=None if flight.reference is None else flight.reference_id,
        zero=zero_words(shown),
        first=int(grid_us[0] // step_us),
        step_us=step_us,
        channels=channels,
        events=tuple(event_rows(shown)),
        vehicle={"rotors_frd_m": [list(rotor.position_m) for rotor in flight.vehicle.rotors]},
    )


def _add_motion(channels: dict[str, Any], flight: Flight, at_us: Times) -> None:
    """Add position (north, east, up), velocity, attitude and body rate."""
    mocap, estimate = flight.mocap, flight.estimate
    pose = mocap or estimate
    if pose is not None:
        channels["p"] = sampled(at_us, pose.t_us, pose.p * UP)
    attitude = estimate or mocap
    if attitude is not None:
        channels["q"] = attitudes(at_us, attitude.t_us, attitude.q)
        channels["attitude"] = euler_deg(channels["q"])
    if estimate is not None:
        channels["v"] = sampled(at_us, estimate.t_us, estimate.v * UP)
        channels["rate"] = sampled(at_us, estimate.t_us, estimate.rate)
    imu = flight.recorded_imu
    if "rate" not in channels and imu is not None and imu.gyro is not None:
        channels["rate"] = sampled(at_us, imu.t_us, imu.gyro)


def _add_reference(channels: dict[str, Any], flight: Flight, at_us: Times) -> None:
    """Add the reference: position, velocity and yaw, over the tracking phase only."""
    inputs = flight.recorded_inputs
    if flight.reference is not None and flight.tracking is not None:
        flat = reference_at(flight.reference, at_us - flight.tracking[0])
        flat[~within(at_us, flight.tracking)] = np.nan
        channels["p_ref"], channels["v_ref"] = flat[:, :3] * UP, flat[:, 3:6] * UP
        channels["yaw_ref"] = wrapped_deg(flat[:, 12])[:, None]
    elif inputs is not None:
        if inputs.p_ref is not None:
            channels["p_ref"] = sampled(at_us, inputs.t_us, inputs.p_ref * UP)
        if inputs.v_ref is not None:
            channels["v_ref"] = sampled(at_us, inputs.t_us, inputs.v_ref * UP)


def _add_control(channels: dict[str, Any], flight: Flight, at_us: Times) -> None:
    """Add motor commands and the commanded body rate."""
    control, inputs = flight.control, flight.recorded_inputs
    if control is not None:
        middle_us = (control.t0_us + control.t1_us) // 2
        channels["motor"] = sampled(at_us, middle_us, control.motor_mean)
        channels["rate_ref"] = sampled(at_us, control.t1_us, control.rate_cmd)
    elif inputs is not None and inputs.motor is not None:
        channels["motor"] = sampled(at_us, inputs.t_us, inputs.motor)


def tracking_rows(
    flight: Flight,
) -> tuple[Annotated[Times, "poses"], Annotated[Floats, "poses 3"]] | None:
    """Return times and pose minus reference, m NED, in the tracking phase; None without a reference."""
    mocap, inputs = flight.mocap, flight.recorded_inputs
    if mocap is None:
        return None
    if flight.reference is not None and flight.tracking is not None:
        errors = tracking_errors_ned(flight)
        return None if errors is None else (mocap.t_us[within(mocap.t_us, flight.tracking)], errors)
    if inputs is None or inputs.p_ref is None:
        return None
    interval_us = flight.tracking or (int(inputs.t_us[0]), int(inputs.t_us[-1]))
    errors = mocap.p - sampled(mocap.t_us, inputs.t_us, inputs.p_ref)
    keep = within(mocap.t_us, interval_us) & np.isfinite(errors).all(axis=1)
    return (mocap.t_us[keep], errors[keep]) if keep.any() else None


def event_rows(shown: ShownFlight) -> list[dict[str, Any]]:
    """Return the events with times from time 0 of the page, s."""
    return [
        {
            "t_s": (event.t_us - shown.zero_us) / 1e6,
            "kind": event.kind,
            "text": FAILSAFE_WORDS.get(event.text, event.text) if event.kind == "failsafe" else event.text,
        }
        for event in shown.events
    ]


def zero_words(shown: ShownFlight) -> str:
    """Return what time 0 is."""
    if shown.flight.kind == "imported":
        return "first sample" if shown.zero_us == 0 else "start of the interval used"
    return "arming" if shown.flight.tracking is None else "start of tracking"


def flight_facts(shown: ShownFlight, path: Path, route: str | None) -> dict[str, Any]:
    """Return the facts of a flight for `--json` and the page. route: name of its route if known."""
    flight, error = shown.flight, tracking_rows(shown.flight)
    tracking = flight.tracking
    distances = None if error is None else np.linalg.norm(error[1], axis=1)
    return {
        "log": str(path),
        "id": flight.id,
        "kind": flight.kind,
        "simulated": is_simulated(flight.metadata),
        "whole": shown.damage is None,
        "damage": shown.damage,
        "vehicle": flight.vehicle.name,
        "reference": flight.reference_id,
        "route": route,
        "duration_s": flight.duration_s,
        "tracking_s": None if tracking is None else [tracking[0] * 1e-6, tracking[1] * 1e-6],
        "tracking_whole": flight.tracking_whole,
        "failsafe": flight.failsafe,
        "error_mean_m": None if distances is None else float(distances.mean()),
        "error_rmse_m": None if distances is None else float(np.sqrt((distances**2).mean())),
        "error_max_m": None if distances is None else float(distances.max()),
        "events": event_rows(shown),
        "notes": flight_notes(shown, route),
    }


def no_route_note(reason: str) -> str:
    """Return the note on a flight or plan whose route is not known."""
    return f"The route is not known, because {reason}. Waypoints, gates and keep-out shapes are not shown."


def flight_notes(shown: ShownFlight, route: str | None) -> list[str]:
    """Return what a reader must know of a flight, as sentences."""
    flight, notes = shown.flight, []
    if shown.damage is not None:
        notes.append(f"The log ends early or is damaged ({shown.damage}). The page shows its intact part.")
    if flight.mocap is None and flight.estimate is None:
        notes.append("The log holds no pose.")
    if flight.tracking is None:
        notes.append("There is no tracking phase, so there is no tracking error.")
    elif not flight.tracking_whole:
        notes.append("The reference was not flown to its end.")
    if flight.failsafe is not None:
        notes.append(f"Ended by failsafe: {FAILSAFE_WORDS.get(flight.failsafe, flight.failsafe)}.")
    if flight.kind == "flight" and is_simulated(flight.metadata) is None:
        notes.append("The log does not record whether the vehicle was simulated.")
    if flight.reference_id is not None and route is None:
        notes.append(no_route_note("no .ref.json file beside the log is that of this reference"))
    return notes
