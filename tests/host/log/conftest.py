"""A small flight written through the writer, for the tests of this folder."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import IO

import pytest

from trimtab.host.log import FLIGHT_TOPICS, LogWriter, Provenance
from trimtab.host.log.writer import Stamps
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol.blobs import Node, Reference
from trimtab.protocol.generated import flight_pb2
from trimtab.protocol.generated.flight_pb2 import Status

ARM_HOST_US = 5_000_000
OFFSET_US = 1234
START_MS = 3000
DURATION_US = 2_000_000


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("research")


@pytest.fixture(scope="session")
def reference(vehicle: Vehicle) -> Reference:
    """Two metres north at 1 m up in two seconds, from rest to rest."""
    still = (0.0,) * 9
    return Reference(
        vehicle_id=vehicle.id,
        origin_ned=(0.0, 0.0, -1.0),
        nodes=(Node(0, (0.0, 0.0, 0.0, *still)), Node(DURATION_US, (2.0, 0.0, 0.0, *still))),
    )


@pytest.fixture(scope="session")
def provenance(vehicle: Vehicle, reference: Reference) -> Provenance:
    return Provenance(
        vehicle=vehicle,
        reference=reference.to_bytes(),
        parameters={"MASS": 0.752, "POS_P_N": 6.0},
        session={"seed": "7", "flight": "0", "arm_host_us": str(ARM_HOST_US)},
    )


@pytest.fixture(scope="session")
def fly(provenance: Provenance) -> Callable[[Path | IO[bytes]], None]:
    """Writes seven seconds of a flight that tracks from 3 s to 5 s; the vehicle clock is 1.234 ms ahead."""

    def write(output: Path | IO[bytes]) -> None:
        with LogWriter(output, provenance, FLIGHT_TOPICS) as log:
            for ms in range(0, 7000, 10):
                publish_us, log_us = ms * 1000, ms * 1000 + 4000
                vehicle_us = ARM_HOST_US + publish_us + OFFSET_US
                p = (ms * 1e-3, math.sin(ms * 1e-3), -1.0)
                q = (1.0, 0.0, 0.0, 0.0)
                log.pose(Stamps(log_us, publish_us, ARM_HOST_US + publish_us), vehicle_us, p, q)
                stamps = Stamps(log_us, publish_us, vehicle_us)
                log.estimate(stamps, p, (1.0, 0.0, 0.0), q, p, p, 8000)
                means = None if ms == 0 else [0.5] * 4 + [0.1] * 3 + [0.0, 0.0, -9.81]
                observed = (ms * 1e-3, 0.0, -1.0) if ms % 50 else ()
                log.control(stamps, 7.4, p, p, p, 10_000, means, observed)
                if ms % 100 == 0:
                    log.write("/fc/status", _status(ms, vehicle_us), log_us, publish_us)
                    link = flight_pb2.Link(frames_sent=ms, clock_offset_us=OFFSET_US, rtt_us=9000.0)
                    log.write("/link", link, log_us, log_us)
            log.text(6_900_000, 6_900_000, 6, "landed", "vehicle")

    return write


def _status(ms: int, vehicle_us: int) -> Status:
    """The status at `ms` after arm."""
    end_ms = START_MS + DURATION_US // 1000
    phases = ((START_MS, Status.TAKEOFF), (end_ms, Status.TRACKING), (end_ms + 1000, Status.HOLD))
    state = next((state for until_ms, state in phases if ms < until_ms), Status.LANDING)
    start_us = ARM_HOST_US + START_MS * 1000 + OFFSET_US if ms >= 2000 else 0
    return Status(
        source_us=vehicle_us,
        state=state,
        battery_v=16.8,
        tracking_start_us=start_us,
    )


@pytest.fixture(scope="session")
def log_bytes(fly: Callable[[IO[bytes]], None]) -> bytes:
    stream = io.BytesIO()
    fly(stream)
    return stream.getvalue()


@pytest.fixture
def log_path(tmp_path: Path, log_bytes: bytes) -> Path:
    path = tmp_path / "flight.mcap"
    path.write_bytes(log_bytes)
    return path
