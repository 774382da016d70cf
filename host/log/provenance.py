"""Provenance of a flight log: what is attached to it and what its metadata contain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import blob_id

FORMAT = "1"
PROVENANCE = "trimtab"
PARAMETERS = "firmware_parameters"
VEHICLE_FILE = "vehicle.toml"
REFERENCE_FILE = "flown.ref"
FEEDFORWARD_FILE = "flown.ff"
THEN_FILE = "then.ref"


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """What a log says about itself before its first message.

    `then` is the reference that was to take over in flight. `session` holds what else is known and may be
    told: session uid, host seed, flight index, version, command.
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
        """Return the entries of the `trimtab` record, sorted; absent things have no entry."""
        told = {
            "format": FORMAT,
            "kind": self.kind,
            "time_unit": "us from arm" if self.kind == "flight" else "us from start",
            "vehicle_id": self.vehicle.id,
            "vehicle_name": self.vehicle.name,
        }
        if self.reference is not None:
            told["reference_id"] = blob_id(self.reference)
        if self.feedforward is not None:
            told["feedforward_id"] = blob_id(self.feedforward)
        if self.then is not None:
            told["then_id"] = blob_id(self.then)
        if self.model_id is not None:
            told["model_id"] = self.model_id
        taken = sorted(set(told) & set(self.session))
        if taken:
            raise ValueError(f"session entries {taken} have a meaning of their own")
        return dict(sorted({**told, **self.session}.items()))
