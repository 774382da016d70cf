"""The request for a flight, and how the flight ended."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from trimtab.host.autopilot.doubt import Doubt
from trimtab.host.autopilot.kinds import AutopilotKind
from trimtab.host.base.errors import UsageError
from trimtab.host.base.parts import PartFile
from trimtab.host.link.host_control import ControlStop, HostControl
from trimtab.host.link.keys import StationKey
from trimtab.host.link.swap import SwapEnd
from trimtab.host.link.takeover import Takeover
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.blobs import FeedForward, Reference

Ask = Callable[[tuple[str, ...]], Callable[[], bool | None]]
"""Shows lines to a person. Returns a function that returns the answer, None before there is one."""


@dataclass(frozen=True, kw_only=True)
class FlightRequest:
    """What to fly, and where to log it.

    Attributes
    ----------
    log_path, log_part
        Flight log to write, and the part that the caller has opened for it. Without one, the flight opens
        its own before arming, and its log replaces an existing one.
    port, cameras
        Names of the vehicle's port and of the camera system in messages.
    upload
        Whether to upload blobs that are not live on board. If False, a missing blob is an error.
    as_flashed
        Whether to fly even if parameters on board differ from the vehicle file.
    parameters
        Values to set on board before the flight, overriding the vehicle file. They stay on board.
    model_id
        Id of the model that the plan was made with.
    session
        Further entries for the provenance in the log.
    camera_delay_us
        Minimum time from exposure to arrival; None if host and cameras share a clock.
    then
        Second reference. It is uploaded in flight and takes over `swap_us` after the start of the first.
    key
        Key of message signing; None for a vehicle without one.
    control
        Controller on the host that flies the reference. None: the vehicle flies it by its own law.
    autopilot
        Make of another autopilot, to which setpoints are streamed; None for a Trimtab vehicle.
    ask
        Asks a person before another autopilot is armed. None: nobody is asked.
    """

    vehicle: Vehicle
    reference: Reference
    log_path: Path
    log_part: PartFile | None = None
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
    key: StationKey | None = None
    control: HostControl | None = None
    autopilot: AutopilotKind | None = None
    ask: Ask | None = None

    def __post_init__(self) -> None:
        if self.control is not None and self.then is not None:
            raise UsageError("a controller on the host flies one reference; leave out the second one")
        for name, blob in (
            ("reference", self.reference),
            ("feed-forward", self.feedforward),
            ("reference", self.then),
        ):
            if blob is not None and blob.vehicle_id != self.vehicle.id:
                raise UsageError(
                    f"the {name} {blob.id} was made for vehicle {blob.vehicle_id}, not for "
                    f"{self.vehicle.name} ({self.vehicle.id}); make it for this vehicle or give the right "
                    "--vehicle"
                )


@dataclass(frozen=True, kw_only=True)
class FlightEnd:
    """How a flight ended.

    `whole`: the reference was flown to its end, without a break. `failsafe`: name of the failsafe that ended
    the flight, if any. `swap`: outcome of the reference swap; None if none was requested. `stop`: why a
    controller on the host ended its commands early; None if it did not, or without one. `takeover`: first
    command of another station that changed the flight, if any. `doubt`: why the host ended the flight of
    another autopilot; None if it did not.
    """

    whole: bool
    failsafe: str | None
    interrupted: bool
    swap: SwapEnd | None = None
    stop: ControlStop | None = None
    takeover: Takeover | None = None
    doubt: Doubt | None = None
