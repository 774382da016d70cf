"""The topics of a log: message type, whether it is sampled or averaged, rate and meaning."""

from __future__ import annotations

from dataclasses import dataclass

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from trimtab.protocol.generated import flight_pb2, host_control_pb2, rotors_pb2, timing_pb2

MOCAP_POSE = "/mocap/pose"
FC_ESTIMATE = "/fc/estimate"
FC_CONTROL = "/fc/control"
FC_ROTORS = "/fc/rotors"
FC_STATUS = "/fc/status"
REFERENCE = "/reference"
HOST_CONTROL = "/host/control"
HOST_TIMING = "/host/timing"
LINK = "/link"
LOG = "/log"
DISPLAY_PREFIX = "/display/"
"""Of the topics for viewers. They repeat what other topics hold."""
DISPLAY_WORLD = "/display/world"
DISPLAY_POSE = "/display/pose"
DISPLAY_VEHICLE = "/display/vehicle"
DISPLAY_PATH = "/display/path"
DISPLAY_REFERENCE = "/display/reference"
DISPLAY_REFERENCE_PATH = "/display/reference_path"
DISPLAY_RESIDUAL = "/display/residual"
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


_SHOWN_TOPICS: tuple[Topic, ...] = (
    Topic(
        name=DISPLAY_WORLD,
        message=FrameTransform,
        sampling="event",
        rate="once",
        content="place of NED in the frame of viewers: x east, y north, z up",
    ),
    Topic(
        name=DISPLAY_VEHICLE,
        message=SceneUpdate,
        sampling="event",
        rate="once",
        content="arms and rotors of the vehicle file, in the body frame",
    ),
    Topic(
        name=DISPLAY_POSE,
        message=FrameTransform,
        sampling="sampled",
        rate="20 Hz",
        content="the mocap pose: place of the body frame in NED",
    ),
    Topic(
        name=DISPLAY_PATH,
        message=PosesInFrame,
        sampling="event",
        rate="once",
        content="positions of /display/pose, NED; written when the log is closed, with the log's first time",
    ),
    Topic(
        name=DISPLAY_REFERENCE_PATH,
        message=PosesInFrame,
        sampling="event",
        rate="once, and when another reference takes over",
        content="positions of the whole reference every 50 ms, NED",
    ),
)
"""What viewers draw of every log."""

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
    *_SHOWN_TOPICS,
    Topic(
        name=DISPLAY_REFERENCE,
        message=PoseInFrame,
        sampling="sampled",
        rate="20 Hz",
        content="the reference now, NED; heading only",
    ),
    Topic(
        name=DISPLAY_RESIDUAL,
        message=SceneUpdate,
        sampling="averaged",
        rate="20 Hz",
        averaged=("entities.arrows",),
        content="specific force that the nominal model does not predict, mean since the last; 1 m is 1 m/s^2",
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

ROTOR_TOPICS: tuple[Topic, ...] = (
    Topic(
        name=FC_ROTORS,
        message=rotors_pb2.Rotors,
        sampling="sampled",
        rate="50-100 Hz",
        content="rotor speeds as the motor controllers measure them, over that at the greatest thrust",
    ),
)
"""Topics that the log of a vehicle holds in addition if it measures rotor speeds."""

TIMING_TOPICS: tuple[Topic, ...] = (
    Topic(
        name=HOST_TIMING,
        message=timing_pb2.Timing,
        sampling="sampled",
        rate="10 Hz",
        content="how late poses arrived at the host, which kept to the wall clock",
    ),
)
"""Topics that the log of a flight at a port holds in addition."""

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
    *_SHOWN_TOPICS,
)
"""Topics of an imported log."""
