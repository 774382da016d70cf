"""The topics of a log: message type, whether it is sampled or averaged, rate and meaning."""

from __future__ import annotations

from dataclasses import dataclass

from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import Message

from trimtab.protocol.generated import flight_pb2, host_control_pb2

MOCAP_POSE = "/mocap/pose"
FC_ESTIMATE = "/fc/estimate"
FC_CONTROL = "/fc/control"
FC_STATUS = "/fc/status"
REFERENCE = "/reference"
HOST_CONTROL = "/host/control"
LINK = "/link"
LOG = "/log"
DISPLAY_POSE = "/display/pose"
DISPLAY_REFERENCE = "/display/reference"
RECORDED_INPUTS = "/recorded/inputs"
RECORDED_IMU = "/recorded/imu"
RECORDED_BATTERY = "/recorded/battery"


@dataclass(frozen=True, kw_only=True)
class Topic:
    """One channel. `sampling` is "sampled", "averaged" (`averaged` lists the fields) or "event"."""

    name: str
    message: type[Message]
    sampling: str
    rate: str
    averaged: tuple[str, ...] = ()
    content: str

    def metadata(self) -> dict[str, str]:
        """Return the metadata of the channel in the file."""
        entries = {"sampling": self.sampling, "rate": self.rate, "content": self.content}
        return entries | {"averaged": " ".join(self.averaged)} if self.averaged else entries


FLIGHT_TOPICS: tuple[Topic, ...] = (
    Topic(
        name=MOCAP_POSE,
        message=flight_pb2.MocapPose,
        sampling="sampled",
        rate="100-200 Hz",
        content="camera pose as it arrived; noise, latency and gaps as they are",
    ),
    Topic(
        name=FC_ESTIMATE,
        message=flight_pb2.Estimate,
        sampling="sampled",
        rate="100 Hz",
        content="on-board estimate and the age of the mocap sample it last used",
    ),
    Topic(
        name=REFERENCE,
        message=flight_pb2.Reference,
        sampling="sampled",
        rate="100 Hz",
        content="flat outputs flown, computed by the host from the blob and the vehicle's clock",
    ),
    Topic(
        name=FC_CONTROL,
        message=flight_pb2.Control,
        sampling="averaged",
        rate="100 Hz",
        averaged=("motor_mean", "gyro_mean_rad_s", "force_mean_m_s2"),
        content="means over the interval that ends at source_us; commands and memory sampled there",
    ),
    Topic(
        name=FC_STATUS,
        message=flight_pb2.Status,
        sampling="sampled",
        rate="10 Hz and on change",
        content="state, failsafe, battery voltage, loop timing, blob ids on board",
    ),
    Topic(
        name=LINK,
        message=flight_pb2.Link,
        sampling="sampled",
        rate="10 Hz",
        content="frames sent, lost and repeated, round trip, clock offsets",
    ),
    Topic(name=LOG, message=Log, sampling="event", rate="events", content="text"),
    Topic(
        name=DISPLAY_POSE,
        message=PoseInFrame,
        sampling="sampled",
        rate="20 Hz",
        content="the mocap pose for display: x east, y north, z up; body x forward, y left, z up",
    ),
    Topic(
        name=DISPLAY_REFERENCE,
        message=PoseInFrame,
        sampling="sampled",
        rate="20 Hz",
        content="the reference for display: x east, y north, z up; heading only",
    ),
)
"""Topics of a flight's log."""

CONTROLLED_TOPICS: tuple[Topic, ...] = (
    *FLIGHT_TOPICS,
    Topic(
        name=HOST_CONTROL,
        message=host_control_pb2.HostControl,
        sampling="sampled",
        rate="step rate",
        content="steps of the controller on the host: outcome, age of the estimate, command and its time",
    ),
)
"""Topics of the log of a flight by a controller on the host."""

IMPORTED_TOPICS: tuple[Topic, ...] = (
    FLIGHT_TOPICS[0],
    Topic(
        name=RECORDED_INPUTS,
        message=flight_pb2.RecordedInputs,
        sampling="sampled",
        rate="as recorded",
        content="what drove the vehicle, at the level the foreign log has",
    ),
    Topic(
        name=RECORDED_IMU,
        message=flight_pb2.RecordedImu,
        sampling="sampled",
        rate="as recorded",
        content="on-board gyro and specific force",
    ),
    Topic(
        name=RECORDED_BATTERY,
        message=flight_pb2.RecordedBattery,
        sampling="sampled",
        rate="as recorded",
        content="battery voltage",
    ),
    FLIGHT_TOPICS[6],
    FLIGHT_TOPICS[7],
)
"""Topics of an imported log."""
