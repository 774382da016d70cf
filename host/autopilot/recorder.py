"""Recorder of another autopilot's flight: what passes the host, on the host's clock from arming."""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_from_euler
from trimtab.host.link.client import Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.pose_timing import PoseTiming
from trimtab.host.link.recorder import Recorder
from trimtab.host.log import LogWriter
from trimtab.host.log.provenance import AUTOPILOT
from trimtab.host.log.writer import Stamps
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.telemetry import TICK_US

_AGE_UNKNOWN_US = 0


class StreamRecorder(Recorder):
    """Log of one flight by streamed setpoints. Parameters as for `Recorder`.

    The on-board estimate is LOCAL_POSITION_NED with the attitude of the newest ATTITUDE. The reference is
    logged as it was sent, at the times at which it was to act.
    """

    def __init__(
        self,
        log: LogWriter,
        client: Client,
        camera: CameraClock,
        reference: Reference,
        arm_us: int,
        *,
        timing: PoseTiming | None,
    ) -> None:
        super().__init__(log, client, camera, reference, arm_us, timing=timing)
        self._attitude: m.Attitude | None = None
        self._handlers |= {m.LocalPositionNed: self._local_position, m.Attitude: self._turned}

    def begin(self, name: str, start_us: int) -> None:
        """Log that the autopilot of this name follows the reference from `start_us` (host's clock) on."""
        self._log.add_metadata(AUTOPILOT, {"name": name, "reference_start_us": str(start_us - self._arm_us)})

    def setpoint(self, acts_us: int, reference_us: int, flat: Sequence[float], now_us: int) -> None:
        """Log a setpoint of the reference: when it is to act (host's clock) and what it says."""
        tick = round(acts_us + self._clock.offset_us) // TICK_US
        self._reference(now_us - self._arm_us, tick, reference_us, flat)

    def _turned(self, message: m.Attitude, log_us: int) -> None:
        self._attitude = message

    def _local_position(self, message: m.LocalPositionNed, log_us: int) -> None:
        attitude = self._attitude
        if attitude is None:
            return
        source_us = 1000 * message.time_boot_ms
        self._log.estimate(
            Stamps(log_us, self._publish_us(source_us), source_us),
            (message.x, message.y, message.z),
            (message.vx, message.vy, message.vz),
            quat_from_euler(FLOAT, attitude.roll, attitude.pitch, attitude.yaw),
            (attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed),
            (0.0, 0.0, 0.0),
            _AGE_UNKNOWN_US,
        )
