"""What to fly, and how the flight ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from trimtab.host.base.errors import UsageError
from trimtab.host.link.swap import SwapEnd
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward, Reference


@dataclass(frozen=True, kw_only=True)
class FlightOrder:
    """What to fly, and where to log it.

    Fields:
        port, cameras: how messages call the vehicle's port and the camera system.
        upload: send what is not live on board; otherwise that is an error.
        as_flashed: fly with parameters on board that differ from the vehicle file.
        parameters: set on board before the flight, over the vehicle file's; they stay there.
        model_id: of the model the plan was made with. session: more for the log's provenance.
        camera_delay_us: least time from exposure to arrival; None where host and cameras share a clock.
        then: a reference to send in flight, which takes over `swap_us` after the first one's start.
    """

    vehicle: Vehicle
    reference: Reference
    log_path: Path
    feedforward: FeedForward | None = None
    port: str = "vehicle"
    cameras: str = "the camera system"
    upload: bool = True
    as_flashed: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    model_id: str | None = None
    session: Mapping[str, str] = field(default_factory=dict)
    camera_delay_us: int | None = None
    then: Reference | None = None
    swap_us: int = 0

    def __post_init__(self) -> None:
        for name, blob in (
            ("reference", self.reference),
            ("feed-forward", self.feedforward),
            ("reference", self.then),
        ):
            if blob is not None and blob.vehicle_id != self.vehicle.id:
                raise UsageError(
                    f"the {name} {blob.id} was made for vehicle {blob.vehicle_id}, not for "
                    f"{self.vehicle.name} ({self.vehicle.id}); plan it anew or give the right --vehicle"
                )


@dataclass(frozen=True, kw_only=True)
class FlightEnd:
    """How a flight ended: `whole` says that the reference was flown to its end, `failsafe` names why not.

    swap: what became of the second reference, None where there was none.
    """

    whole: bool
    failsafe: str | None
    interrupted: bool
    swap: SwapEnd | None = None
