"""Messages found in streams and packed into radio frames."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import messages as m
from protocol.codec import Codec
from protocol.uwb import (
    CAPACITY_BYTES,
    FRAME_BYTES,
    LONGEST_BYTES,
    PRIORITIES,
    FramePacker,
    Priority,
    StreamSplitter,
    message_id,
)

CODEC = Codec(1, 1)


def pose(k: int = 1) -> bytes:
    return CODEC.encode(m.AttPosMocap(k, (1.0, 0.0, 0.0, 0.0), 1.0, 2.0, 3.0))


def control(k: int = 1) -> bytes:
    return CODEC.encode(
        m.FcControl(k, 7.0, (1, 2, 3), (1, 2, 3), (1, 2, 3, 4), (1, 2, 3), (1, 2, 3), (1, 2, 3))
    )


def estimate(k: int = 1) -> bytes:
    return CODEC.encode(m.FcEstimate(k, (1, 2, 3), (1, 2, 3), (1, 2, 3, 4), (1, 2, 3), 1, (1, 2, 3)))


def timesync() -> bytes:
    return CODEC.encode(m.Timesync(2**62, 2**62))


def command() -> bytes:
    return CODEC.encode(m.CommandLong(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))


def text() -> bytes:
    return CODEC.encode(m.StatusText(6, b"x" * 50))


def chunk(k: int = 1) -> bytes:
    return CODEC.encode(m.UploadChunk(1, k, 1, b"\x01" * 99))


@settings(max_examples=100)
@given(
    seed=st.integers(0, 2**32),
    cuts=st.lists(st.integers(1, 400), max_size=40),
    loss=st.sampled_from([0.0, 0.002, 0.05]),
)
def test_splitter_gives_whole_messages_of_the_stream_in_order_and_stays_small(seed, cuts, loss) -> None:
    rng = random.Random(seed)
    makers = (pose, control, estimate, timesync, command, text, chunk)
    sent = [rng.choice(makers)() for _ in range(40)]
    stream = bytes(byte for byte in b"".join(sent) if rng.random() >= loss) + bytes(LONGEST_BYTES)
    splitter, found, at = StreamSplitter(), [], 0
    for cut in (*cuts, len(stream)):
        found += splitter.feed(stream[at : at + cut])
        at += cut
        assert splitter.pending_bytes < LONGEST_BYTES
    kept = iter(sent)
    assert all(message in kept for message in found)
    assert sum(map(len, found)) + splitter.bad_bytes + splitter.pending_bytes == len(stream)
    assert splitter.messages == len(found)
    if not loss:
        assert found == sent


def test_splitter_loses_only_the_message_that_a_lost_byte_belongs_to() -> None:
    frames = [control(1), estimate(1), pose(1)]
    for lost in range(len(frames[1])):
        damaged = frames[1][:lost] + frames[1][lost + 1 :]
        splitter = StreamSplitter()
        assert splitter.feed(frames[0] + damaged + frames[2] + bytes(LONGEST_BYTES)) == [frames[0], frames[2]]


def test_splitter_skips_mavlink_1_and_unknown_ids() -> None:
    splitter = StreamSplitter()
    unknown = bytes([0xFD, 9, 0, 0, 0, 1, 1, 99, 0, 0]) + bytes(11)
    assert splitter.feed(b"\xfe\x09\x00\x01\x01\x00" + bytes(11) + unknown + pose()) != []
    assert splitter.messages == 1
    assert splitter.bad_bytes == 17 + 21


def test_every_message_has_a_class_and_uploads_come_last() -> None:
    assert PRIORITIES[message_id(pose())] is Priority.URGENT
    assert PRIORITIES[message_id(timesync())] is Priority.URGENT
    assert PRIORITIES[message_id(command())] is Priority.URGENT
    assert PRIORITIES[message_id(control())] is PRIORITIES[message_id(estimate())] is Priority.CONTROL
    assert PRIORITIES[message_id(text())] is Priority.STATUS
    assert PRIORITIES[message_id(chunk())] is Priority.UPLOAD


def test_packer_sends_the_most_urgent_first_and_fills_the_frame() -> None:
    packer = FramePacker()
    for message in (chunk(), text(), control(), command(), pose()):
        assert packer.offer(message)
    frames = []
    while (frame := packer.take()) is not None:
        frames.append([message_id(message) for message in StreamSplitter().feed(frame)])
    assert frames == [[138, 76], [52100], [253], [52111]]
    assert packer.packed == 5
    assert packer.waiting == 0


def test_packer_never_splits_nor_exceeds_the_frame() -> None:
    rng = random.Random(5)
    packer, offered, taken = FramePacker(poses=3), [], []
    for _ in range(300):
        message = rng.choice((pose, control, estimate, timesync, command, text, chunk))()
        if packer.offer(message):
            offered.append(message)
        if rng.random() < 0.6 and (frame := packer.take()) is not None:
            assert len(frame) <= FRAME_BYTES
            taken += StreamSplitter().feed(frame)
    while (frame := packer.take()) is not None:
        taken += StreamSplitter().feed(frame)
    assert len(taken) == packer.packed
    assert set(taken) <= set(offered)
    assert len(offered) - len(taken) == packer.replaced + _dropped_control(offered, taken)


def _dropped_control(offered: list[bytes], taken: list[bytes]) -> int:
    gone = set(offered) - set(taken)
    return sum(PRIORITIES[message_id(message)] is Priority.CONTROL for message in gone)


def test_packer_keeps_order_within_a_class() -> None:
    packer = FramePacker()
    sent = [chunk(k) for k in range(20)]
    for message in sent:
        packer.offer(message)
    assert [packer.take() for _ in sent] == sent


def test_packer_replaces_a_waiting_pose_by_the_newest() -> None:
    packer = FramePacker()
    first, second = pose(1), pose(2)
    packer.offer(first)
    packer.offer(second)
    assert packer.take() == second
    assert packer.take() is None
    assert packer.replaced == 1


def test_packer_for_two_poses_sends_them_in_one_frame() -> None:
    packer = FramePacker(poses=2)
    sent = [pose(k) for k in range(3)]
    for message in sent:
        packer.offer(message)
    assert packer.take() == sent[1] + sent[2]


def test_packer_with_a_full_queue_refuses_and_counts_but_keeps_the_newest_telemetry() -> None:
    packer = FramePacker()
    room = CAPACITY_BYTES[Priority.UPLOAD] // len(chunk())
    results = [packer.offer(chunk(k)) for k in range(room + 3)]
    assert results == [True] * room + [False] * 3
    assert packer.refused == 3
    telemetry = [control(k) for k in range(10)]
    assert all(packer.offer(message) for message in telemetry)
    kept = CAPACITY_BYTES[Priority.CONTROL] // len(control())
    assert packer.refused == 3 + 10 - kept
    assert [packer.take() for _ in range(kept)] == telemetry[-kept:]


def test_packer_counts_what_fits_no_frame() -> None:
    packer = FramePacker()
    signed = CODEC.encode(m.UploadChunk(1, 1, 1, b"\x01" * 99)) + bytes(13)
    assert not packer.offer(signed)
    assert packer.oversize == 1


def test_packer_for_no_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        FramePacker(poses=0)
