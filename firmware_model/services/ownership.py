"""Ownership of a flight: which station may command it, send it poses and keep its link alive.

The station that arms the vehicle owns the flight until the vehicle disarms. In flight, commands, setpoints,
uploads and changes of files are accepted from the owner only. Poses are accepted from one station only, in
flight from the one that sent them at arming. Other stations may read; OWN_OTHERS says whether they may also
land the vehicle or terminate its flight.

A station is a MAVLink system and component. Without signing, a message can carry a false sender.
"""

from __future__ import annotations

from collections.abc import Callable

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.supervisor import Event
from trimtab.firmware_model.services.recent import remember
from trimtab.protocol.messages import Station, mavlink, station_name

STATIONS_MAX = 16
"""Greatest number of stations that are remembered."""
REPORTS_MAX = 4
"""Greatest number of texts about refused stations in one flight."""
_LAND, _TERMINATE = 1.0, 2.0
"""Least values of OWN_OTHERS that let other stations land the vehicle, and terminate its flight."""
_WARNING = mavlink.MAV_SEVERITY_WARNING


class Ownership:
    """Decides for each message whether its sender may act on the vehicle.

    Parameters
    ----------
    text
        Sends severity and text to all stations.
    """

    def __init__(self, *, flight: Flight, text: Callable[[int, str], None]) -> None:
        self._flight = flight
        self._text = text
        self._heard_us: dict[Station, int] = {}
        self._pose_us: dict[Station, int] = {}
        self._pose_source: Station | None = None
        self._setpoint_source: Station | None = None
        self._reported: set[tuple[Station, str]] = set()

    @property
    def owner(self) -> Station | None:
        """Station that owns the present flight; None in standby."""
        return self._flight.course.owner

    def hear(self, station: Station, now_us: int) -> None:
        """Record a message of a station; the owner's and the pose source's keep the link alive."""
        remember(self._heard_us, station, now_us, STATIONS_MAX)
        if self.takes_part(station):
            self._flight.host_heard(now_us)

    def takes_part(self, station: Station) -> bool:
        """Return whether a station has a part in the present flight; in standby every station has."""
        owner = self.owner
        return owner is None or station in (owner, self._pose_source)

    def other_stations(self, station: Station, now_us: int, within_us: int) -> bool:
        """Return whether any other station was heard within the last `within_us`."""
        return any(
            other != station and now_us - heard_us <= within_us for other, heard_us in self._heard_us.items()
        )

    def may_act(self, station: Station) -> bool:
        """Return whether a station may change anything: the owner in flight, every station in standby."""
        return self.owner in (None, station)

    def admit(self, station: Station, what: str) -> bool:
        """Return `may_act`, and report a refusal once for each station and kind of message `what`."""
        owner = self.owner
        if owner in (None, station):
            return True
        if (station, what) not in self._reported and len(self._reported) < REPORTS_MAX:
            self._reported.add((station, what))
            self._text(_WARNING, f"{what} of station {station_name(station)} refused: not the owner")
        return False

    def admit_setpoint(self, station: Station) -> bool:
        """Return whether a setpoint of this station is to be stored."""
        if not self.admit(station, "setpoints"):
            return False
        self._setpoint_source = station
        return True

    def refusal(self, event: Event, station: Station, now_us: int, *, terminates: bool = False) -> str | None:
        """Return why a station may not command `event`, or None.

        terminates: whether KILL was commanded as a flight termination rather than as a forced disarm.
        """
        owner = self.owner
        if owner is None:
            return self._arming_refusal(station, now_us) if event is Event.ARM else None
        if station == owner:
            foreign = event is Event.OFFBOARD and self._setpoint_source not in (None, owner)
            return "no setpoints of yours: stream them first" if foreign else None
        others = self._flight.parameters["OWN_OTHERS"]
        if event is Event.LAND and others >= _LAND:
            return None
        if event is Event.KILL and terminates and others >= _TERMINATE:
            return None
        return f"the flight is owned by station {station_name(owner)}"

    def admit_pose(self, station: Station, now_us: int) -> bool:
        """Return whether a pose of this station is to be used.

        In standby, a station takes over once the present source has been silent for FS_MOCAP_S.
        """
        remember(self._pose_us, station, now_us, STATIONS_MAX)
        if station == self._pose_source:
            return True
        if self.owner is None and not self._sends_poses(self._pose_source, now_us):
            self._pose_source = station
            return True
        self.admit(station, "poses")
        return False

    def _sends_poses(self, station: Station | None, now_us: int) -> bool:
        if station is None or station not in self._pose_us:
            return False
        return now_us - self._pose_us[station] <= self._flight.parameters.us("FS_MOCAP_S")

    def _arming_refusal(self, station: Station, now_us: int) -> str | None:
        """Return why this station may not arm: its poses are not in use, or there are two sources."""
        self._reported.clear()
        source = self._pose_source
        senders = [other for other in self._pose_us if self._sends_poses(other, now_us)]
        if station in senders and source != station:
            self._pose_source = station
            self._flight.restart_estimate(now_us)
            return "poses of another station were in use"
        if station not in senders and len(senders) > 1:
            return "poses of two stations: {} and {}".format(*map(station_name, sorted(senders)[:2]))
        return None
