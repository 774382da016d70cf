"""Uploads in flight: a reference of 20.8 kB is sent while another is flown, in lock-step.

Each flight is flown twice from the same seed, with and without the upload. Its cost is measured at the
radios: the slots that carry a part of it, and the additional delay of each pose at the ground radio.
"""

from __future__ import annotations

import dataclasses
import hashlib
import tempfile
from pathlib import Path
from typing import Any

from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Node, Reference
from trimtab.protocol.stream import message_id, split
from trimtab.sitl.studies.upload_blob import NODES, reference_blob
from trimtab.sitl.vehicle import SimulatedVehicle
from trimtab.sitl.world import RadioSettings

LOSS = 0.1
RADIOS: dict[str, dict[str, float]] = {
    "flight": {},
    "flight-loss": {"loss": LOSS, "burst_frames": 1.0 / (1.0 - LOSS)},
}
"""Settings that differ from the simulator's defaults: none; 10 % independent loss."""
_FIRST_NODES, _SWAP_NODE, _STEP_US = 81, 50, 10_000
_UPLOAD = {one.id for one in (m.UploadBegin, m.UploadChunk, m.UploadStatus, m.UploadVerdict, m.UploadCommit)}
_POSE_US = 10_000


def references() -> tuple[Reference, Reference, int]:
    """Return the first reference, the second (20.8 kB), which continues it to rest, and the swap time, us."""
    first = Reference.from_bytes(reference_blob("research", 0, _FIRST_NODES))
    at_us = first.nodes[_SWAP_NODE].t_us
    nodes = [Node(node.t_us - at_us, node.state) for node in first.nodes[_SWAP_NODE:]]
    last = nodes[-1]
    resting = range(1, NODES - len(nodes) + 1)
    nodes += [Node(last.t_us + k * _STEP_US, last.state) for k in resting]
    return first, dataclasses.replace(first, nodes=tuple(nodes), free_ends=True), at_us


class _Air:
    """Time at which each pose was first sent (by exposure number), and frames with a part of an upload."""

    def __init__(self) -> None:
        self.poses: dict[int, int] = {}
        self.upload: list[tuple[int, bytes]] = []

    def __call__(self, now_us: int, frame: bytes) -> None:
        messages = split(frame)
        if any(message_id(message) in _UPLOAD for message in messages):
            self.upload.append((now_us, frame))
        for message in messages:
            if message_id(message) == m.AttPosMocap.id:
                stamp_us = int.from_bytes(message[10:18], "little")
                self.poses.setdefault(round(stamp_us / _POSE_US), now_us)


def fly_upload(channel: str, seed: int, number: int) -> dict[str, Any]:
    """Fly once with and once without the upload, and return plain data.

    `seconds` is the duration of the upload; None if the reference did not take over. `slot_share` is the
    share of slots in that time. `mocap_delays_us` are the additional delays of the poses in that time.
    """
    first, then, at_us = references()
    result, air = _fly(channel, seed, number, first, then, at_us)
    _, alone = _fly(channel, seed, number, first, None, 0)
    swap = result.to_dict()["swap"]
    digest = hashlib.sha256(then.to_bytes()).digest()
    begin_us = next(left_us for left_us, frame in air.upload if digest in frame)  # of its first UPLOAD_BEGIN
    end_us = begin_us + round(1e6 * (swap["upload_s"] or 0.0))
    frames = sum(begin_us <= left_us <= end_us for left_us, _ in air.upload)
    shared = [k for k in air.poses.keys() & alone.poses.keys() if begin_us <= air.poses[k] <= end_us]
    return {
        "seconds": swap["upload_s"] if swap["happened"] else None,
        "slot_share": frames * RadioSettings().slot_us / max(1, end_us - begin_us),
        "mocap_delays_us": sorted(air.poses[k] - alone.poses[k] for k in shared),
    }


def _fly(
    channel: str, seed: int, number: int, first: Reference, then: Reference | None, at_us: int
) -> tuple[FlightResult, _Air]:
    craft, air = load_vehicle("research"), _Air()
    vehicle = SimulatedVehicle.create(craft, world_seed=seed, flight=number, radio=RADIOS[channel])
    vehicle.watch_air(air)
    with tempfile.TemporaryDirectory() as folder:
        request = FlightRequest(
            vehicle=craft, reference=first, log_path=Path(folder) / "flight.mcap", then=then, swap_us=at_us
        )
        return fly_lockstep(request, vehicle), air
