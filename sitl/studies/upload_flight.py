"""Uploads in flight: a reference of 20.8 kB is sent while another is flown, host and vehicle in lock-step.

Each flight is flown twice from the same seed, with the upload and without. What the upload costs is seen
where the radios' frames leave: the slots that carry something of it, and how much later a pose leaves the
ground radio than the same pose did without.
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
"""Settings that differ from the simulator's own: none; a tenth of the frames lost, each on its own."""
_FIRST_NODES, _SWAP_NODE, _STEP_US = 81, 50, 10_000
_UPLOAD = {one.id for one in (m.UploadBegin, m.UploadChunk, m.UploadStatus, m.UploadVerdict, m.UploadCommit)}
_POSE_US = 10_000


def references() -> tuple[Reference, Reference, int]:
    """Return what is flown first, what takes over (20.8 kB, from the first one's path to rest), and when, in
    us.
    """
    first = Reference.from_bytes(reference_blob("research", 0, _FIRST_NODES))
    at_us = first.nodes[_SWAP_NODE].t_us
    nodes = [Node(node.t_us - at_us, node.state) for node in first.nodes[_SWAP_NODE:]]
    last = nodes[-1]
    resting = range(1, NODES - len(nodes) + 1)
    nodes += [Node(last.t_us + k * _STEP_US, last.state) for k in resting]
    return first, dataclasses.replace(first, nodes=tuple(nodes), free_ends=True), at_us


class _Air:
    """When each pose left first (by the number of its exposure), and frames with something of an upload."""

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
    """One flight, with upload and without, as plain data.

    seconds: from the announcement to the agreement; None where the reference did not take over. slot_share:
    of the slots in that time. mocap_delays_us: of every pose meanwhile, against the flight without.
    """
    first, then, at_us = references()
    result, air = _fly(channel, seed, number, first, then, at_us)
    _, alone = _fly(channel, seed, number, first, None, 0)
    swap = result.to_json()["swap"]
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
