"""Originals that the fuzzer damages: bytes of a real session, its log and blobs, and the shipped files."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from trimtab.firmware_model.law.reference import septic
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.route import list_routes
from trimtab.host.vehicle import Vehicle, list_vehicles, load_vehicle
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, Node, Reference, TrainedRegion, YawNode
from trimtab.sitl.vehicle import Setting, SimulatedVehicle
from trimtab.sitl.world import list_worlds

_REST = (0.0,) * 9
_MODEL = """kind = "trimtab-model"
version = 1
vehicle_id = "{vehicle.id}"
vehicle_name = "{vehicle.name}"
data = ["0123456789ab"]

[effects.linear-drag]
dx = 0.4
dy = 0.3
dz = 0.1

[adjustments.thrust-gain]
gain = 1.02

[covariance]
names = ["linear-drag.dx", "linear-drag.dy"]
matrix = [[0.01, 0.001], [0.001, 0.02]]

[region]
speed_max_m_s = 4.0
tilt_max_deg = 35.0
thrust_min_n = 4.0
thrust_max_n = 12.0
"""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Originals of the inputs.

    Attributes
    ----------
    up, down, poses
        Writes of host, vehicle and cameras in one session.
    reference, feedforward
        Blobs on board.
    log
        Log of the flight.
    texts
        TOML files by kind (`vehicle`, `route`, `world`, `model`).
    """

    vehicle: Vehicle
    up: tuple[bytes, ...]
    down: tuple[bytes, ...]
    poses: tuple[bytes, ...]
    reference: bytes
    feedforward: bytes
    log: bytes
    texts: dict[str, tuple[bytes, ...]]


class _Tapped(SimulatedVehicle):
    """A vehicle that records its input and output."""

    def __init__(self, setting: Setting, flight: int, store: ReferenceStore) -> None:
        super().__init__(setting, flight, store)
        self.up: list[bytes] = []
        self.down: list[bytes] = []
        self.poses: list[bytes] = []

    def serial_read(self) -> bytes:
        data = super().serial_read()
        if data:
            self.down.append(data)
        return data

    def serial_write(self, data: bytes) -> None:
        self.up.append(data)
        super().serial_write(data)

    def mocap_read(self) -> list[bytes]:
        datagrams = super().mocap_read()
        self.poses += datagrams
        return datagrams


def short_reference(vehicle: Vehicle, seconds: float = 1.2, reach: float = 0.5) -> Reference:
    """Return a reference north by `reach` and back, at rest at both ends."""
    nodes, us = [], round(1e6 * seconds)
    for leg, (start, end) in enumerate(((0.0, reach), (reach, 0.0))):
        for k in range(4 + leg):
            p, v, a, j, _ = septic(
                seconds, seconds * k / 4, (start, 0.0, -0.6, *_REST), (end, 0.0, -0.6, *_REST)
            )
            nodes.append(Node(leg * us + us * k // 4, (*p, *v, *a, *j)))
    yaws = (YawNode(0, 0.2, 0.0), YawNode(2 * us, 0.3, 0.0))
    return Reference(vehicle_id=vehicle.id, origin_ned=(0.0, 0.0, 0.0), nodes=tuple(nodes), yaws=yaws)


@lru_cache(maxsize=1)
def record() -> Source:
    """Fly briefly in the empty world, including uploads, and return the recorded bytes and files."""
    vehicle = load_vehicle("research")
    reference = short_reference(vehicle)
    feedforward = FeedForward(
        vehicle_id=vehicle.id,
        model_id="0123456789ab",
        block=(1.02, *NEUTRAL_BLOCK[1:12], 0.004, 0.5, -0.2, 0.0, 1.8),
        layers=(4,),
        weights=(0.01,) * (4 * 4 + 5 * 3),
        frame="body",
        region=TrainedRegion(3.0, 0.5, 5.0, 16.0),
    )
    tapped = _Tapped.create(vehicle, world="empty")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        request = FlightRequest(vehicle=vehicle, reference=reference, feedforward=feedforward, log_path=path)
        fly_lockstep(request, tapped)
        log = path.read_bytes()
    files = {"vehicle": list_vehicles(), "route": list_routes(), "world": list_worlds()}
    texts = {kind: tuple(path.read_bytes() for path in paths.values()) for kind, paths in files.items()}
    texts["model"] = (_MODEL.format(vehicle=vehicle).encode(),)
    return Source(
        vehicle=vehicle,
        up=tuple(tapped.up),
        down=tuple(tapped.down),
        poses=tuple(tapped.poses),
        reference=reference.to_bytes(),
        feedforward=feedforward.to_bytes(),
        log=log,
        texts=texts,
    )
