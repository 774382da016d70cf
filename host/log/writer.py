"""Writer for flight logs: MCAP with protobuf messages, 64 KiB zstd chunks, provenance first.

Times are integer microseconds on the host's clock from arm: a log starts when the vehicle acknowledges
arming. Messages that arrived or were measured before that are not logged, because the format has no negative
times. The file holds them in nanoseconds.

The file is a part (`trimtab.host.base.parts`) until it is closed. Every chunk is written as soon as it is
full, so a killed writer loses at most the last chunk. `trimtab.host.log.recover` reads the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple, Self, cast

from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap_protobuf.schema import build_file_descriptor_set

from trimtab.host.base.parts import NameTaken, PartFile, open_only_part
from trimtab.host.base.text import escaped, readable
from trimtab.host.log import topics
from trimtab.host.log.display import Display, stamp
from trimtab.host.log.errors import LogError
from trimtab.host.log.file_time import LAST_US
from trimtab.host.log.mcap_file import McapFile, Sink
from trimtab.host.log.provenance import (
    FEEDFORWARD_FILE,
    PARAMETERS,
    PROVENANCE,
    REFERENCE_FILE,
    THEN_FILE,
    VEHICLE_FILE,
    Provenance,
)
from trimtab.host.log.topics import Topic
from trimtab.protocol.generated import flight_pb2, rotors_pb2


class _Unbuffered:
    """An unbuffered file: a write has reached the operating system when it returns.

    After a failed write (LogError) every later write fails too, because nothing after half a record can be
    read. `mcap` is the file that is written to it, once that has begun. `all_or_nothing`: whether the file is
    removed after an error.
    """

    def __init__(self, part: PartFile) -> None:
        self.failed: LogError | None = None
        self.mcap: McapFile | None = None
        self.all_or_nothing = False
        self._part = part

    @property
    def recoverable(self) -> bool:
        """Whether a part of what was written can be recovered: a whole chunk."""
        return self.mcap is not None and self.mcap.chunks > 0 and not self.all_or_nothing

    def write(self, data: bytes, /) -> None:
        if self.failed is not None:
            raise self.failed
        view = memoryview(data)
        try:
            while view:
                view = view[self._part.file.write(view) or 0 :]
        except OSError as error:
            self.failed = LogError(self._why(error))
            raise self.failed from error

    def _why(self, error: OSError) -> str:
        if not self.recoverable:
            return f"{self._part.target}: cannot be written ({error.strerror}); free disk space and try again"
        return (
            f"{self._part.target}: cannot be written any further ({error.strerror}); free disk space, "
            f"then read the part written so far with `trimtab log recover {self._part.path}`"
        )


class Stamps(NamedTuple):
    """Times of a message, us: of logging, of publication, and of creation on its source's clock."""

    log_us: int
    publish_us: int
    source_us: int


class LogWriter:
    """Writer of one log to `output`: a path, a part that its owner publishes, or a binary stream.

    At a path, the closed log replaces an existing file. Call `close` at the end. As a context manager, it
    removes the file if the block raises. Any method raises LogError if the file cannot be written; the part
    then stays if it holds anything that can be recovered.

    The methods named after topics take the stamps and then the topic's values. They return False if a time
    lies before arming. Message objects are reused. `display` writes what viewers draw.
    """

    def __init__(
        self,
        output: Path | PartFile | IO[bytes],
        provenance: Provenance,
        channels: Sequence[Topic] = topics.FLIGHT_TOPICS,
    ) -> None:
        self._part: PartFile | None = None
        self._sink: _Unbuffered | None = None
        self._closed = False
        self._publishes = isinstance(output, Path)
        sink: Sink
        if isinstance(output, Path | PartFile):
            self._part = _opened(output) if isinstance(output, Path) else output
            sink = self._sink = _Unbuffered(self._part)
        else:
            sink = output
        try:
            self._mcap = McapFile(sink)
            if self._sink is not None:
                self._sink.mcap = self._mcap
            self._write_provenance(provenance)
        except BaseException:
            self._discard()
            raise
        self._add = self._mcap.add_message
        self._schemas: dict[str, int] = {}
        self._channels = {topic.name: self._register(topic) for topic in channels}
        self._messages = _Messages()
        self.display = Display(self._write_shown, provenance.vehicle)

    def _write_provenance(self, provenance: Provenance) -> None:
        self._mcap.add_metadata(PROVENANCE, provenance.metadata())
        if provenance.parameters is not None:
            values = {name: repr(float(value)) for name, value in sorted(provenance.parameters.items())}
            self._mcap.add_metadata(PARAMETERS, values)
        attach = self._mcap.add_attachment
        attach(VEHICLE_FILE, "application/toml", provenance.vehicle.to_toml().encode())
        if provenance.reference is not None:
            attach(REFERENCE_FILE, "application/octet-stream", provenance.reference)
        if provenance.then is not None:
            attach(THEN_FILE, "application/octet-stream", provenance.then)
        if provenance.feedforward is not None:
            attach(FEEDFORWARD_FILE, "application/octet-stream", provenance.feedforward)

    def _register(self, topic: Topic) -> int:
        name = topic.message.DESCRIPTOR.full_name
        if name not in self._schemas:
            described = build_file_descriptor_set(cast(Any, topic.message))
            self._schemas[name] = self._mcap.add_schema(name, described.SerializeToString(deterministic=True))
        return self._mcap.add_channel(topic.name, self._schemas[name], topic.metadata())

    def holds(self, topic: str) -> bool:
        """Return whether the log has a channel for a topic."""
        return topic in self._channels

    def write(self, topic: str, message: Any, log_us: int, publish_us: int) -> bool:
        """Write a message of any topic. If the file cannot hold its times, write nothing and return False."""
        if not (0 <= log_us <= LAST_US and 0 <= publish_us <= LAST_US):
            return False
        self._add(self._channels[topic], log_us, publish_us, message.SerializeToString())
        return True

    def _write_shown(self, topic: str, message: Any, log_us: int, publish_us: int) -> bool:
        """Write a message of a display topic, unless the log lacks that topic."""
        return self.holds(topic) and self.write(topic, message, log_us, publish_us)

    def counts(self) -> dict[str, int]:
        """Return the number of messages by topic, of topics with any. Call it after `close`."""
        counts = self._mcap.counts
        return {topic: counts[channel] for topic, channel in self._channels.items() if counts[channel]}

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record that is known only in flight."""
        self._mcap.add_metadata(name, entries)

    def pose(
        self,
        stamps: Stamps,
        vehicle_us: int,
        p_ned: Sequence[float],
        q_ned_frd: Sequence[float],
    ) -> bool:
        """Write `/mocap/pose`; `vehicle_us` is the stamp it was forwarded with, 0 if it was not forwarded."""
        message = self._messages.pose
        message.source_us = stamps.source_us
        message.vehicle_us = vehicle_us
        message.p_ned_m[:] = p_ned
        message.q_ned_frd[:] = q_ned_frd
        return self.write(topics.MOCAP_POSE, message, stamps.log_us, stamps.publish_us)

    def estimate(
        self,
        stamps: Stamps,
        p_ned: Sequence[float],
        v_ned: Sequence[float],
        q_ned_frd: Sequence[float],
        rate_frd: Sequence[float],
        gyro_bias: Sequence[float],
        mocap_age_us: int,
    ) -> bool:
        """Write `/fc/estimate`."""
        message = self._messages.estimate
        message.source_us = stamps.source_us
        message.p_ned_m[:] = p_ned
        message.v_ned_m_s[:] = v_ned
        message.q_ned_frd[:] = q_ned_frd
        message.rate_frd_rad_s[:] = rate_frd
        message.gyro_bias_rad_s[:] = gyro_bias
        message.mocap_age_us = mocap_age_us
        return self.write(topics.FC_ESTIMATE, message, stamps.log_us, stamps.publish_us)

    def rotors(self, stamps: Stamps, speed: Sequence[float]) -> bool:
        """Write `/fc/rotors`. speed: over that at the greatest thrust."""
        message = rotors_pb2.Rotors(source_us=stamps.source_us, speed=speed)
        return self.write(topics.FC_ROTORS, message, stamps.log_us, stamps.publish_us)

    def reference(
        self,
        stamps: Stamps,
        reference_id: str,
        reference_us: int,
        flat: Sequence[float],
    ) -> bool:
        """Write `/reference`; `flat` is p, v, a, j (3 each), yaw, yaw rate."""
        message = self._messages.reference
        message.source_us = stamps.source_us
        message.reference_id = reference_id
        message.reference_us = reference_us
        message.p_ned_m[:] = flat[0:3]
        message.v_ned_m_s[:] = flat[3:6]
        message.a_ned_m_s2[:] = flat[6:9]
        message.j_ned_m_s3[:] = flat[9:12]
        message.yaw_rad = flat[12]
        message.yaw_rate_rad_s = flat[13]
        return self.write(topics.REFERENCE, message, stamps.log_us, stamps.publish_us)

    def control(
        self,
        stamps: Stamps,
        collective_n: float,
        rate_cmd: Sequence[float],
        torque_cmd: Sequence[float],
        rate_integral: Sequence[float],
        interval_us: int,
        means: Sequence[float] | None,
        observer_ned: Sequence[float] = (),
    ) -> bool:
        """Write `/fc/control`; `means`: motor 4, gyro 3, specific force 3, or None for an invalid interval.

        `observer_ned`: the disturbance observed, empty for none.
        """
        message = self._messages.control
        message.source_us = stamps.source_us
        message.interval_us = 0 if means is None else interval_us
        message.collective_n = collective_n
        message.rate_cmd_rad_s[:] = rate_cmd
        message.torque_cmd_n_m[:] = torque_cmd
        message.rate_integral[:] = rate_integral
        message.motor_mean[:] = () if means is None else means[0:4]
        message.gyro_mean_rad_s[:] = () if means is None else means[4:7]
        message.force_mean_m_s2[:] = () if means is None else means[7:10]
        message.observer_ned_m_s2[:] = observer_ned
        return self.write(topics.FC_CONTROL, message, stamps.log_us, stamps.publish_us)

    def text(self, log_us: int, publish_us: int, severity: int, text: str, name: str) -> bool:
        """Write `/log`; `severity` as in STATUSTEXT (0 emergency .. 7 debug), `name` is the sender."""
        message = self._messages.text
        message.level = _foxglove_level(severity)
        message.message = readable(escaped(text))
        message.name = name
        stamp(message.timestamp, publish_us)
        return self.write(topics.LOG, message, log_us, publish_us)

    @property
    def whole(self) -> bool:
        """Whether the log was closed with everything in it."""
        return self._closed and (self._sink is None or self._sink.failed is None)

    def close(self) -> None:
        """Write index and footer; at a path, publish the file.

        Do nothing more a second time, or after a failed write.
        """
        if self._closed:
            return
        self._closed = True
        part, sink = self._part, self._sink
        if part is None or sink is None:
            self._finish()
            return
        try:
            if sink.failed is None:
                self._finish()
                if self._publishes:
                    publish_log(part)
        finally:
            if sink.failed is not None and not sink.recoverable:
                part.discard()
            elif self._publishes:
                part.close()

    def _finish(self) -> None:
        self.display.finish()
        self._mcap.finish()

    def _discard(self) -> None:
        """Remove the file. A stream stays as it is."""
        self._closed = True
        if self._part is not None:
            self._part.discard()

    def __enter__(self) -> Self:
        if self._sink is not None:
            self._sink.all_or_nothing = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self._discard()


class _Messages:
    """The reused message objects of a writer."""

    def __init__(self) -> None:
        self.pose = flight_pb2.MocapPose()
        self.estimate = flight_pb2.Estimate()
        self.reference = flight_pb2.Reference()
        self.control = flight_pb2.Control()
        self.text = Log()


def _foxglove_level(severity: int) -> Any:
    """Return the Foxglove level for a MAVLink severity."""
    if severity <= 2:
        return Log.FATAL
    if severity == 3:
        return Log.ERROR
    if severity == 4:
        return Log.WARNING
    return Log.INFO if severity <= 6 else Log.DEBUG


def publish_log(part: PartFile) -> None:
    """Give a whole log its name. Raises LogError if that cannot be done; the part then stays."""
    try:
        part.publish()
    except NameTaken as error:
        reason, cause = "another file has it now", error
    except OSError as error:
        reason, cause = str(error.strerror), error
    else:
        return
    raise LogError(
        f"{part.target}: the log cannot get this name ({reason}); it is whole in {part.path}, rename that"
    ) from cause


def _opened(path: Path) -> PartFile:
    try:
        return open_only_part(path, force=True)
    except OSError as error:
        raise LogError(f"{path}: cannot be written ({error.strerror}); give another -o") from error
