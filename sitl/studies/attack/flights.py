"""Flights beside a stranger, in lock-step: what it changes, what `fly` reports, and what is true."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from trimtab.firmware_model.law.reference import septic
from trimtab.host.base.errors import TrimtabError
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded, fly_lockstep
from trimtab.host.link.keys import StationKey
from trimtab.host.link.summary import FlightResult
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Node, Reference, YawNode
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.studies.attack.flood import FloodedVehicle, flood_frames
from trimtab.sitl.studies.attack.frames import KEY
from trimtab.sitl.studies.attack.interference import KINDS
from trimtab.sitl.studies.attack.stranger import ADDRESS, SharedVehicle, Stranger, Wrapper
from trimtab.sitl.vehicle import SimulatedVehicle

DEPARTED_M = 0.3
"""Distance from the undisturbed flight above which a flight counts as changed."""
CRASH_M_S = 2.0
"""Sink rate just above the floor above which a landing counts as a crash."""
FLOOR_M = 0.15
FLOOD_HZ = 10_000
SAMPLE_US = 10_000
FALL_US = 1_500_000
"""Time for which a vehicle is watched after a flight."""
ALLOWED = ("land", "terminate")
"""Kinds that other stations may do by default."""
STATIONS = {"stranger": ADDRESS, "owner": m.HOST}
"""Addresses that a stranger uses."""
_LEG_S, _REACH_M, _HEIGHT_M = 2.5, 1.0, 1.2

Track = list[tuple[float, float, float]]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a flight beside a stranger.

    `flown`: whether `fly` reports the reference as flown. `takeover`: the command that it names, if any.
    `departed_m`: greatest distance of the true position from that of the undisturbed flight, up to the end of
    the tracking phase. `crashed`: whether it hit the floor fast. `error`: what else `fly` says, if it fails.
    """

    kind: str
    address: str
    signed: bool
    flown: bool
    takeover: str | None
    departed_m: float
    crashed: bool
    error: str | None

    @property
    def changed(self) -> bool:
        """Return whether the stranger changed the flight."""
        return self.departed_m > DEPARTED_M or self.crashed or self.takeover is not None

    @property
    def misreported(self) -> bool:
        """Return whether a changed flight was reported as flown."""
        return self.flown and self.changed


def there_and_back(vehicle_id: str) -> Reference:
    """Return a reference of two legs north and back, with a node every quarter of a second."""
    rest = (0.0,) * 9
    ends = ((0.0, 0.0, -_HEIGHT_M, *rest), (_REACH_M, 0.0, -_HEIGHT_M, *rest))
    nodes = []
    for leg in (0, 1):
        for k in range(10 + leg):
            t_s = 0.1 * k * _LEG_S
            p, v, a, j, _ = septic(_LEG_S, t_s, ends[leg], ends[1 - leg])
            nodes.append(Node(round(1e6 * (leg * _LEG_S + t_s)), (*p, *v, *a, *j)))
    return Reference(
        vehicle_id=vehicle_id, origin_ned=(0.0, 0.0, 0.0), nodes=tuple(nodes), yaws=(YawNode(0, 0.0, 0.0),)
    )


def interfere(kind: str, address: str, *, signed: bool, seed: int) -> dict[str, Any]:
    """Fly beside a stranger that interferes, and return the outcome as plain data.

    address: a key of STATIONS. With `signed`, vehicle and host have a key and the stranger has none.
    """
    quiet = _quiet(signed=signed, seed=seed)
    track, ended = _fly(KINDS[kind](), STATIONS[address], signed=signed, seed=seed)
    result = ended if isinstance(ended, FlightResult) else None
    end = None if result is None else result.end
    flown = end is not None and end.whole
    common = min(len(quiet), len(track))
    departed_m = max(
        (math.dist(a, b) for a, b in zip(quiet[:common], track[:common], strict=True)), default=0.0
    )
    outcome = Outcome(
        kind=kind,
        address=address,
        signed=signed,
        flown=flown,
        takeover=None if end is None or end.takeover is None else end.takeover.command,
        departed_m=departed_m if flown else 0.0,
        crashed=_crashed(track),
        error=str(ended) if isinstance(ended, TrimtabError) else None,
    )
    return {**asdict(outcome), "changed": outcome.changed, "misreported": outcome.misreported}


@cache
def _quiet(*, signed: bool, seed: int) -> Track:
    """Return the track of the flight beside a stranger that does nothing."""
    return _fly(lambda stranger: [], ADDRESS, signed=signed, seed=seed)[0]


def _crashed(track: Track) -> bool:
    sinks = (100.0 * (b[2] - a[2]) for a, b in pairwise(track) if b[2] > -FLOOR_M)  # samples every 10 ms
    return max(sinks, default=0.0) > CRASH_M_S


def _fly(
    act: Callable[[Stranger], Any], address: tuple[int, int], *, signed: bool, seed: int
) -> tuple[Track, FlightResult | TrimtabError]:
    """Return the true positions every 10 ms, and the result or the error of the flight.

    The positions begin with the reference, or with arming if it was not flown: a lost command delays a flight
    without changing it.
    """
    vehicle = load_vehicle("research")
    simulated = SimulatedVehicle.create(vehicle, flight=seed, key=KEY if signed else None)
    samples: list[tuple[int, tuple[float, float, float]]] = []

    def watch(stranger: Stranger) -> Any:
        if stranger.state > m.mavlink.TRIMTAB_STATE_STANDBY or samples:
            samples.append((stranger.now_us, simulated.true_position()))
        return act(stranger)

    stranger = Stranger(watch, address)
    shared = SharedVehicle(simulated, stranger)
    ended: FlightResult | TrimtabError
    try:
        ended = _flown(vehicle, shared, StationKey(key=KEY, name="study.key") if signed else None)
    except TrimtabError as error:
        ended = error
    for _ in range(FALL_US // SAMPLE_US):  # a vehicle whose motors were stopped in the air still falls
        end_us = simulated.now_us + SAMPLE_US
        while simulated.now_us < end_us:
            simulated.run_until(end_us)
            simulated.serial_read()
            simulated.mocap_read()
        samples.append((simulated.now_us, simulated.true_position()))
    status = stranger.status
    flown = status is not None and status.reference_tick != m.NO_TICK
    start_us = TICK_US * status.reference_tick if status is not None and flown else 0
    return [position for t_us, position in samples if t_us >= start_us], ended


def _flown(vehicle: Vehicle, simulated: Wrapper, key: StationKey | None = None) -> FlightResult:
    """Return the result of a flight, also if it ended early. Raises TrimtabError without a result."""
    with tempfile.TemporaryDirectory() as folder:
        request = FlightRequest(
            vehicle=vehicle,
            reference=there_and_back(vehicle.id),
            log_path=Path(folder) / "flight.mcap",
            key=key,
        )
        try:
            return fly_lockstep(request, simulated)
        except FlightEnded as error:
            return error.result


def flood(seed: int) -> dict[str, Any]:
    """Fly without and with a flood, and return both tracking errors and how the second flight ended."""
    vehicle = load_vehicle("research")
    rows: dict[str, Any] = {"seed": seed}
    for name, rate_hz in (("quiet", 0), ("flooded", FLOOD_HZ)):
        flooded = FloodedVehicle(
            SimulatedVehicle.create(vehicle, flight=seed), flood_frames(600, seed), rate_hz
        )
        result = _flown(vehicle, flooded)
        rows[f"{name}_rmse_m"] = result.tracking_rmse_m
        rows[f"{name}_whole"] = result.end is not None and result.end.whole
        rows[f"{name}_failsafe"] = None if result.end is None else result.end.failsafe
    rows["packets"] = flooded.sent
    return rows
