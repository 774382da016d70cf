"""A flight in memory: the arrays of its topics, and what is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trimtab.host.log.contents import LogContents
from trimtab.host.log.rebuilt import Rebuilt
from trimtab.host.log.tracks import (
    Battery,
    Control,
    Estimate,
    HostControl,
    LinkHealth,
    Mocap,
    Observer,
    RecordedImu,
    RecordedInputs,
    Rotors,
    Status,
    Timing,
)
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward, Reference


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """One flight or import. Absent data is None.

    Attributes
    ----------
    id, path
        First 12 hex digits of the SHA-256 of the log, and its path.
    kind
        "flight" or "imported".
    vehicle
        The vehicle file in the log.
    reference, reference_id
        Reference that was flown.
    feedforward, firmware_parameters
        Feed-forward that was flown, and the parameters on board by name.
    metadata
        Provenance of the log: version, command, host seed, index of the flight, and others.
    mocap, estimate, control, observer, status, link
        Arrays of each topic.
    recorded_inputs, recorded_imu
        Inputs and IMU of a foreign vehicle.
    battery
        Voltage over time.
    tracking
        Start and end of the interval that learning and errors use, us.
    tracking_whole
        Whether the reference was flown to its end. Always True for an import.
    unused
        Begin and end of each part of `tracking` that is not used, us: the time on the ground between several
        flights in one imported log. Empty otherwise.
    rebuilt
        Part of the attitude in `mocap` that an import rebuilt; None if all was measured.
    failsafe
        Name of the failsafe that ended the flight: a key of FAILSAFE_WORDS.
    duration_s
        Duration of the log, s.
    contents
        Size and topics of the log's file.
    host_control
        Steps of a controller on the host; None if the vehicle flew by its own law, or in an import.
    rotors
        Measured rotor speeds; None if the vehicle reports none.
    timing
        How the host kept to the wall clock; None for a flight in lock-step, or in an import.
    """

    id: str
    path: Path
    kind: str
    vehicle: Vehicle
    reference: Reference | None
    reference_id: str | None
    feedforward: FeedForward | None
    firmware_parameters: Mapping[str, float] | None
    metadata: Mapping[str, str]
    mocap: Mocap | None
    estimate: Estimate | None
    control: Control | None
    observer: Observer | None
    status: Status | None
    link: LinkHealth | None
    recorded_inputs: RecordedInputs | None
    recorded_imu: RecordedImu | None
    battery: Battery | None
    tracking: tuple[int, int] | None
    tracking_whole: bool
    failsafe: str | None
    duration_s: float
    contents: LogContents
    host_control: HostControl | None = None
    unused: tuple[tuple[int, int], ...] = ()
    rebuilt: Rebuilt | None = None
    rotors: Rotors | None = None
    timing: Timing | None = None

    @property
    def tracking_parts(self) -> tuple[tuple[int, int], ...]:
        """Begin and end of each part of the tracking phase that is used, us."""
        if self.tracking is None:
            return ()
        edges = [self.tracking[0], *(edge for part in self.unused for edge in part), self.tracking[1]]
        return tuple(zip(edges[::2], edges[1::2], strict=True))

    @property
    def flown_by_own_law(self) -> bool:
        """Whether the reference and the law on board explain the flight: no other controller commanded."""
        known = self.reference is not None and self.firmware_parameters is not None
        return known and self.host_control is None

    def to_dict(self) -> dict[str, Any]:
        """Return the object that `trimtab log info --json` prints, as plain data."""
        from trimtab.host.log.info import describe

        return describe(self)

    def __repr__(self) -> str:
        return f"<Flight {self.path.name}, id {self.id}, {self.duration_s:.2f} s>"

    def _repr_html_(self) -> str:
        from trimtab.host.log.info import flight_card

        return flight_card(self)
