"""Provenance of a flight log: what is attached to it and what its metadata contain."""

from __future__ import annotations

import datetime
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from trimtab.host.base.artefacts import without_options
from trimtab.host.base.text import escaped, readable
from trimtab.host.log.file_time import NANOSECONDS, TIME_UNIT
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import blob_id

Origin = Literal["simulated", "port", "imported"]

FORMAT = "1"
PROVENANCE = "trimtab"
PARAMETERS = "firmware_parameters"
AUTOPILOT = "autopilot"
"""Record of a flight by setpoints streamed to another autopilot, written when the reference begins."""
HOST_CONTROL = "host_control"
"""Record of a controller on the host, written when it takes over."""
UNUSED = "unused_us"
"""Entry of an import: begins and ends, us, of the parts of the tracking phase that are not used."""
VEHICLE_FILE = "vehicle.toml"
REFERENCE_FILE = "flown.ref"
FEEDFORWARD_FILE = "flown.ff"
THEN_FILE = "then.ref"
_EPOCH_MIN_US = 946_684_800_000_000
"""The year 2000. An earlier `epoch_us` counts from the start of a clock, not from 1970."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a log, written before its first message.

    `then` is the reference that was to take over in flight. `session` holds further entries: session uid,
    host seed, flight index, version, command.
    """

    vehicle: Vehicle
    kind: str = "flight"
    reference: bytes | None = None
    feedforward: bytes | None = None
    then: bytes | None = None
    model_id: str | None = None
    parameters: Mapping[str, float] | None = None
    session: Mapping[str, str] = field(default_factory=dict)

    def metadata(self) -> dict[str, str]:
        """Return the sorted entries of the `trimtab` record. Absent values have no entry."""
        entries = {
            "format": FORMAT,
            "kind": self.kind,
            TIME_UNIT: NANOSECONDS,
            "vehicle_id": self.vehicle.id,
            "vehicle_name": self.vehicle.name,
        }
        if self.reference is not None:
            entries["reference_id"] = blob_id(self.reference)
        if self.feedforward is not None:
            entries["feedforward_id"] = blob_id(self.feedforward)
        if self.then is not None:
            entries["then_id"] = blob_id(self.then)
        if self.model_id is not None:
            entries["model_id"] = self.model_id
        reserved = sorted(set(entries) & set(self.session))
        if reserved:
            raise ValueError(f"session entries {reserved} are reserved names")
        return {key: readable(escaped(value)) for key, value in sorted({**entries, **self.session}.items())}


SIMULATED = "simulated"
"""Entry of a flight's metadata: "yes" or "no", as the firmware said; absent if it left that open."""
_SIMULATING_VERBS = frozenset({"bench", "demo", "fly", "plan", "study"})
"""Verbs that fly a simulated vehicle unless they are given a port."""


def flown_by(simulated: bool | None, utc_us: int | None) -> dict[str, str]:
    """Return the entries about who flew and when: whether it was simulated, and the date of a real flight.

    simulated: as the vehicle says; None if it does not say. utc_us: us since 1970 at arming; None without a
    wall clock. A simulated flight has no date, so that the same seeds give the same bytes.
    """
    entries = {} if simulated is None else {SIMULATED: "yes" if simulated else "no"}
    return entries if simulated or utc_us is None else entries | {"epoch_us": str(utc_us)}


def origin_of(metadata: Mapping[str, str]) -> Origin | None:
    """Return where the flight of a log was flown; None where its `trimtab` record does not tell.

    The writer stores what the vehicle's firmware said. In older logs, a command without a port flew a
    simulated vehicle; the vehicle at a port may be simulated or real.
    """
    kind = metadata.get("kind")
    if kind == "imported":
        return "imported"
    if SIMULATED in metadata:
        return "simulated" if metadata[SIMULATED] == "yes" else "port"
    try:
        words = shlex.split(metadata.get("command", ""))[1:]
    except ValueError:
        return None
    if kind != "flight" or words[:1] == [] or words[0] not in _SIMULATING_VERBS:
        return None
    return "simulated" if without_options(words, ("--port",)) == words else "port"


def is_simulated(metadata: Mapping[str, str]) -> bool | None:
    """Return whether the vehicle of a log was simulated; None where that is not known."""
    if SIMULATED in metadata:
        return metadata[SIMULATED] == "yes"
    return True if origin_of(metadata) == "simulated" else None


def utc_date(metadata: Mapping[str, str]) -> datetime.datetime | None:
    """Return the UTC date and time of a log's first sample, to the second, from its `trimtab` record.

    None if the log has no date, or one of a clock that does not count from 1970.
    """
    epoch_us = metadata.get("epoch_us", "")
    if not epoch_us.isdigit() or int(epoch_us) < _EPOCH_MIN_US:
        return None
    try:
        return datetime.datetime.fromtimestamp(int(epoch_us) // 1_000_000, datetime.UTC)
    except (OverflowError, ValueError, OSError):
        return None


def date_text(date: datetime.datetime | None) -> str | None:
    """Return a UTC date and time as text for JSON and the terminal; None for None."""
    return None if date is None else date.strftime("%Y-%m-%dT%H:%M:%SZ")


def count_simulated(records: Iterable[Mapping[str, str]]) -> int:
    """Return how many logs with these `trimtab` records are known to be of a simulated vehicle."""
    return sum(is_simulated(metadata) is True for metadata in records)
