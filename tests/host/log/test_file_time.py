"""Times in the file are nanoseconds; logs of older versions, in microseconds, hold the same flight."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from trimtab.host.log import Flight, LogWriter, Provenance, read_flight, recover
from trimtab.host.log.export import csv_tables
from trimtab.host.log.file_time import LAST_US
from trimtab.host.log.writer import Stamps

DATA = Path(__file__).parents[2] / "data"


def _as_older_versions_wrote_it(log: bytes) -> bytes:
    """Return the log with microseconds for nanoseconds, written by the mcap package."""
    reader, stream = make_reader(io.BytesIO(log)), io.BytesIO()
    writer = Writer(stream, chunk_size=64 * 1024)
    writer.start(profile="", library="trimtab")
    for record in reader.iter_metadata():
        unit = {"time_unit": "us from arm"} if record.name == "trimtab" else {}
        writer.add_metadata(record.name, {**record.metadata, **unit})
    for attachment in reader.iter_attachments():
        writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        assert schema is not None
        assert message.log_time % 1000 == message.publish_time % 1000 == 0
        if channel.id not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number, {**channel.metadata, "time_unit": "us"}
            )
        writer.add_message(
            channels[channel.id], message.log_time // 1000, message.data, message.publish_time // 1000
        )
    writer.finish()
    return stream.getvalue()


@pytest.fixture(scope="module")
def old_bytes(log_bytes: bytes) -> bytes:
    return _as_older_versions_wrote_it(log_bytes)


def _arrays(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every number and array of a flight with its name, without those that belong to the file."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if name or field.name not in ("id", "path", "metadata", "contents"):
                yield from _arrays(getattr(value, field.name), f"{name}.{field.name}")
    else:
        yield name, value


def _assert_same(a: Flight, b: Flight) -> None:
    pairs = list(zip(_arrays(a), _arrays(b), strict=True))
    assert len(pairs) > 40
    for (name, first), (other, second) in pairs:
        assert name == other
        if isinstance(first, np.ndarray):
            np.testing.assert_array_equal(first, second, err_msg=name)
        else:
            assert first == second, name


def test_log_lasts_as_long_for_other_readers_as_for_ours(log_path: Path) -> None:
    with log_path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    spanned_ns = summary.statistics.message_end_time - summary.statistics.message_start_time
    assert (
        spanned_ns * 1e-9
        == pytest.approx(read_flight(log_path).to_dict()["duration_s"])
        == pytest.approx(6.994)
    )
    assert read_flight(log_path).to_dict()["provenance"]["time_unit"] == "ns"


def test_log_of_an_older_version_reads_to_the_same_flight(
    tmp_path: Path, log_path: Path, old_bytes: bytes
) -> None:
    old = tmp_path / "old.mcap"
    old.write_bytes(old_bytes)
    _assert_same(read_flight(old), read_flight(log_path))
    assert csv_tables(old) == csv_tables(log_path)
    assert read_flight(old).to_dict()["duration_s"] == read_flight(log_path).to_dict()["duration_s"]


def test_recover_cut_log_of_an_older_version_is_written_in_nanoseconds(
    tmp_path: Path, log_path: Path, old_bytes: bytes
) -> None:
    cut = tmp_path / "old.mcap"
    cut.write_bytes(old_bytes[: len(old_bytes) // 2])
    recovery = recover(cut)
    assert recovery.output is not None
    part, whole = read_flight(recovery.output), read_flight(log_path)
    assert part.mocap is not None
    assert whole.mocap is not None
    count = len(part.mocap)
    assert 100 < count < len(whole.mocap)
    np.testing.assert_array_equal(part.mocap.t_us, whole.mocap.t_us[:count])
    np.testing.assert_array_equal(part.mocap.t_arrival_us, whole.mocap.t_arrival_us[:count])
    assert part.metadata["time_unit"] == "ns"
    with recovery.output.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        _, _, first = next(reader.iter_messages(topics=["/mocap/pose"]))
    assert summary is not None
    assert first.log_time == 4_000_000
    assert not any("time_unit" in channel.metadata for channel in summary.channels.values())


def test_recover_cut_log_keeps_its_times(tmp_path: Path, log_path: Path, log_bytes: bytes) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log_bytes[:-40])
    recovery = recover(cut)
    assert recovery.output is not None
    _assert_same(read_flight(recovery.output), read_flight(log_path))


def test_log_flown_by_an_older_version_lasts_seconds() -> None:
    flight = read_flight(DATA / "a1.mcap")
    assert flight.metadata["time_unit"] == "us from arm"
    assert flight.tracking is not None
    assert flight.reference is not None
    assert flight.tracking[1] - flight.tracking[0] == flight.reference.duration_us
    assert flight.duration_s > 1e-6 * flight.reference.duration_us > 1.0


def test_writer_time_beyond_the_format_is_not_logged(provenance: Provenance) -> None:
    stream, q = io.BytesIO(), (1.0, 0.0, 0.0, 0.0)
    with LogWriter(stream, provenance) as log:
        assert log.pose(Stamps(3000, LAST_US, 0), 0, (0.0, 0.0, 0.0), q)
        assert not log.pose(Stamps(3000, LAST_US + 1, 0), 0, (0.0, 0.0, 0.0), q)
    (_, _, message), *others = make_reader(io.BytesIO(stream.getvalue())).iter_messages(["/mocap/pose"])
    assert (message.log_time, message.publish_time, others) == (3_000_000, 1000 * LAST_US, [])
