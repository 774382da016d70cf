"""A log reads back as the flight that was written."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from trimtab.host.log import (
    FAILSAFE_WORDS,
    FLIGHT_TOPICS,
    LogError,
    LogWriter,
    Provenance,
    failsafe_name,
    read_flight,
    to_lines,
)
from trimtab.host.log.writer import Stamps
from trimtab.protocol.blobs import Reference
from trimtab.protocol.messages import mavlink


def test_flight_written_reads_back(log_path: Path, reference: Reference) -> None:
    flight = read_flight(log_path)
    assert flight.id == hashlib.sha256(log_path.read_bytes()).hexdigest()[:12]
    assert flight.vehicle.name == "research"
    assert flight.reference == reference
    assert flight.reference_id == reference.id
    assert flight.firmware_parameters == {"MASS": 0.752, "POS_P_N": 6.0}
    assert flight.failsafe is None
    assert flight.mocap is not None
    assert flight.estimate is not None
    assert flight.control is not None
    np.testing.assert_array_equal(flight.mocap.t_us, np.arange(0, 7_000_000, 10_000))
    np.testing.assert_array_equal(flight.mocap.t_arrival_us - flight.mocap.t_us, 4000)
    np.testing.assert_allclose(flight.mocap.p[:, 0], np.arange(700) * 0.01)
    np.testing.assert_allclose(flight.estimate.mocap_age_s, 0.008)
    assert flight.mocap.q.shape == (700, 4)


def test_flight_vehicle_stamps_are_translated_to_the_host_clock(log_path: Path) -> None:
    flight = read_flight(log_path)
    assert flight.estimate is not None
    assert flight.status is not None
    np.testing.assert_array_equal(flight.estimate.t_us, np.arange(0, 7_000_000, 10_000))
    np.testing.assert_array_equal(flight.status.t_us, np.arange(0, 7_000_000, 100_000))


def test_flight_tracking_starts_where_the_vehicle_says_and_ends_with_the_reference(log_path: Path) -> None:
    flight = read_flight(log_path)
    assert flight.tracking == (3_000_000, 5_000_000)
    assert flight.tracking_whole


def test_observer_has_the_rows_that_came_whatever_their_interval(log_path: Path) -> None:
    observer = read_flight(log_path).observer
    assert observer is not None
    at_ms = [ms for ms in range(0, 7000, 10) if ms % 50]
    np.testing.assert_array_equal(observer.t_us, np.multiply(at_ms, 1000))
    np.testing.assert_allclose(observer.disturbance[:, 0], np.multiply(at_ms, 1e-3))
    np.testing.assert_allclose(observer.disturbance[:, 1:], [[0.0, -1.0]] * len(at_ms))


def test_control_invalid_interval_is_left_out(log_path: Path) -> None:
    control = read_flight(log_path).control
    assert control is not None
    assert len(control) == 699
    np.testing.assert_array_equal(control.t1_us - control.t0_us, 10_000)
    np.testing.assert_allclose(control.motor_mean, 0.5)
    np.testing.assert_allclose(control.force_mean[:, 2], -9.81)


def test_log_same_flight_twice_gives_the_same_bytes(
    fly: Callable[[IO[bytes]], None], log_bytes: bytes
) -> None:
    again = io.BytesIO()
    fly(again)
    assert again.getvalue() == log_bytes


def test_log_on_disk_equals_log_in_memory(
    tmp_path: Path, fly: Callable[[Path], None], log_bytes: bytes
) -> None:
    fly(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == log_bytes
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_log_independent_reader_finds_topics_times_and_sampling(log_bytes: bytes) -> None:
    reader = make_reader(io.BytesIO(log_bytes), decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == {t.name for t in FLIGHT_TOPICS}
    assert all(c.metadata["sampling"] in ("sampled", "averaged", "event") for c in summary.channels.values())
    names = {schema.name for schema in summary.schemas.values()}
    assert {"foxglove.Log", "foxglove.PoseInFrame", "trimtab.MocapPose", "trimtab.Control"} <= names
    first = next(iter(reader.iter_decoded_messages(topics=["/mocap/pose"])))
    assert (first.message.log_time, first.message.publish_time) == (4_000_000, 0)
    assert list(first.decoded_message.p_ned_m) == [0.0, 0.0, -1.0]


def test_log_independent_reader_seeks_and_counts(log_bytes: bytes) -> None:
    # The reference implementation checks every CRC and finds messages through the chunk and message indexes.
    reader = make_reader(io.BytesIO(log_bytes), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(list(reader.iter_messages())) == 3 * 700 + 2 * 70 + 3
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 2
    start_ns, end_ns = summary.statistics.message_start_time, summary.statistics.message_end_time
    assert (start_ns, end_ns) == (0, 6_994_000_000)
    times_ns = range(3_004_000_000, 3_504_000_000, 10_000_000)
    middle = reader.iter_messages(
        topics=["/fc/estimate"], starting_at=times_ns.start, ending_before=times_ns.stop
    )
    assert [message.log_time for _, _, message in middle] == list(times_ns)
    assert [attachment.name for attachment in reader.iter_attachments()] == ["vehicle.toml", "flown.ref"]
    assert {record.name for record in reader.iter_metadata()} == {"trimtab", "firmware_parameters"}
    whole = StreamReader(io.BytesIO(log_bytes), validate_crcs=True)
    assert sum(isinstance(record, Message) for record in whole.records) == 2243


def test_log_provenance_comes_before_the_first_message(log_bytes: bytes) -> None:
    chunk = log_bytes.index(b"zstd")
    for mark in (b"vehicle.toml", b"flown.ref", b"firmware_parameters", b"vehicle_id"):
        assert log_bytes.index(mark) < chunk


def test_writer_message_from_before_arm_is_not_logged(provenance: Provenance) -> None:
    stream = io.BytesIO()
    with LogWriter(stream, provenance) as log:
        assert not log.pose(Stamps(-1, -9000, 0), 0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        assert not log.pose(Stamps(3000, -1, 0), 0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        assert log.pose(Stamps(3000, 0, 0), 0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    reader = make_reader(io.BytesIO(stream.getvalue()))
    assert len(list(reader.iter_messages(topics=["/mocap/pose"]))) == 1


def test_read_flight_row_that_is_not_finite_is_left_out(tmp_path: Path, provenance: Provenance) -> None:
    path = tmp_path / "x.mcap"
    with LogWriter(path, provenance) as log:
        for k, x in enumerate((0.0, math.nan, 2.0)):
            log.pose(Stamps(k, k, k), 0, (x, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    mocap = read_flight(path).mocap
    assert mocap is not None
    np.testing.assert_array_equal(mocap.p[:, 0], [0.0, 2.0])
    assert mocap.left_out == 1


def test_read_flight_row_whose_quaternion_is_zero_is_left_out(tmp_path: Path, provenance: Provenance) -> None:
    path = tmp_path / "x.mcap"
    zeros = (0.0, 0.0, 0.0)
    with LogWriter(path, provenance) as log:
        for k, w in enumerate((1.0, 0.0, 1.0)):
            log.pose(Stamps(k, k, k), 0, (k, 0.0, 0.0), (w, *zeros))
            log.estimate(Stamps(k, k, k), (k, 0.0, 0.0), zeros, (w, *zeros), zeros, zeros, 1)
    flight = read_flight(path)
    for track in (flight.mocap, flight.estimate):
        assert track is not None
        np.testing.assert_array_equal(track.p[:, 0], [0.0, 2.0])
        assert track.left_out == 1


def test_provenance_session_entry_with_a_taken_name_is_refused(provenance: Provenance) -> None:
    with pytest.raises(ValueError, match="vehicle_id"):
        dataclasses.replace(provenance, session={"vehicle_id": "x"}).metadata()


def test_read_flight_missing_file_names_it(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nowhere\.mcap: cannot be read"):
        read_flight(tmp_path / "nowhere.mcap")


@pytest.mark.parametrize("content", [b"", b"not a log", b"\x89PNG\r\n\x1a\n" * 9])
def test_read_flight_something_else_says_so(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        read_flight(path)
    assert caught.value.exit_code == 5
    assert "\n" not in str(caught.value)


def test_read_flight_swapped_reference_is_refused(
    tmp_path: Path, log_bytes: bytes, reference: Reference
) -> None:
    blob = reference.to_bytes()
    other = bytearray(blob)
    other[60] ^= 1
    path = tmp_path / "x.mcap"
    path.write_bytes(log_bytes.replace(blob, bytes(other)))
    with pytest.raises(LogError, match="reference_id"):
        read_flight(path)


def test_failsafe_names_are_those_of_the_messages_and_have_words() -> None:
    prefix = "TRIMTAB_FAILSAFE_"
    numbers = {
        name.removeprefix(prefix): getattr(mavlink, name)
        for name in dir(mavlink)
        if name.startswith(prefix) and not name.endswith("_ENUM_END") and getattr(mavlink, name)
    }
    named = {failsafe_name(number): number for number in numbers.values()}
    assert named == {name.lower().replace("_", "-"): number for name, number in numbers.items()}
    assert set(FAILSAFE_WORDS) == set(named)
    assert failsafe_name(0) is None
    assert failsafe_name(99) == "99"


def test_describe_says_what_is_in_it(log_path: Path) -> None:
    told = read_flight(log_path).to_dict()
    assert told["tracking_s"] == [3.0, 5.0]
    assert told["topics"]["/mocap/pose"] == {"messages": 700, "rate_hz": 100.0, "sampling": "sampled"}
    assert told["topics"]["/fc/control"]["sampling"] == "averaged"
    text = "\n".join(to_lines(told))
    assert "research" in text
    assert "tracking from 3.00 to 5.00 s" in text
