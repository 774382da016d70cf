"""Closed routes: a lap from the first waypoint back to it, flown several times without a stop."""

from __future__ import annotations

from trimtab.host.route.model import Route

LAPS_MAX = 100


def flown(lap: Route, laps: int) -> Route:
    """Return a route of `laps` laps. The gates are on every lap, and the waypoint times repeat.

    lap: ends where it starts. Its total_time_s and its yaw are those of the whole flight.
    """
    legs = len(lap.waypoints_m) - 1
    fields: dict[str, object] = {"waypoints_m": lap.waypoints_m + lap.waypoints_m[1:] * (laps - 1)}
    if lap.gates is not None:
        fields["gates"] = tuple(
            gate.model_copy(update={"waypoint": gate.waypoint + legs * number})
            for number in range(laps)
            for gate in lap.gates
        )
    if lap.times_s is not None:
        later = (number * lap.duration_s + t_s for number in range(1, laps) for t_s in lap.times_s[1:])
        fields["times_s"] = (*lap.times_s, *later)
    return lap.model_copy(update=fields)
