"""Messages found in streams and packed into radio frames."""

from __future__ import annotations

import random
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.narrowing import not_none
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.stream import HEADER_BYTES, MAGIC, MESSAGE_BYTES_MAX, StreamSplitter, message_id, split
from trimtab.protocol.uwb import CAPACITY_BYTES, PRIORITIES, FramePacker, Priority
from trimtab.protocol.uwb_pieces import (
    FRAME_BYTES,
    FRAME_BYTES_MIN,
    PIECE,
    PIECE_HEADER_BYTES,
    PIECE_TIMEOUT_US,
    PIECED_MESSAGES_MAX,
    Assembler,
    split_message,
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


def text(k: int = 1) -> bytes:
    return CODEC.encode(m.StatusText(6, b"x" * 50))


def chunk(k: int = 1) -> bytes:
    return CODEC.encode(m.UploadChunk(1, k, 1, b"\x01" * 99))


@cache
def ftp(k: int = 1) -> bytes:
    """The longest message of a stock file transfer, the same bytes each time."""
    return CODEC.encode(m.mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, [k & 0xFF] * 250 + [0xFF]))


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
    stream = bytes(byte for byte in b"".join(sent) if rng.random() >= loss) + bytes(MESSAGE_BYTES_MAX)
    splitter, found, at = StreamSplitter(), [], 0
    for step in (*cuts, len(stream)):
        found += splitter.feed(stream[at : at + step])
        at += step
        assert splitter.pending_bytes < MESSAGE_BYTES_MAX
    kept = iter(sent)
    assert all(message in kept for message in found)
    assert sum(map(len, found)) + splitter.bad_bytes + splitter.pending_bytes == len(stream)
    if not loss:
        assert found == sent


def test_splitter_loses_only_the_message_that_a_lost_byte_belongs_to() -> None:
    frames = [control(1), estimate(1), pose(1)]
    for lost in range(len(frames[1])):
        damaged = frames[1][:lost] + frames[1][lost + 1 :]
        splitter = StreamSplitter()
        assert splitter.feed(frames[0] + damaged + frames[2] + bytes(MESSAGE_BYTES_MAX)) == [
            frames[0],
            frames[2],
        ]


def signed(message: bytes, signature: bytes) -> bytes:
    """The message with the mark of a signed one, and this for a signature."""
    body = bytes([message[1], 1]) + message[3:-2]
    seed = m.mavlink.mavlink_map[message_id(message)].crc_extra
    crc = m.mavlink.x25crc(body + bytes([seed])).crc
    return message[:1] + body + crc.to_bytes(2, "little") + signature


@pytest.mark.parametrize("whole", [pose(), signed(pose(), bytes(range(13)))], ids=["plain", "signed"])
def test_datagram_that_ends_within_a_message_has_none_of_it(whole: bytes) -> None:
    assert split(b"\xfd" + whole) == [whole]
    assert [end for end in range(len(whole)) if split(whole[:end])] == []


def test_datagram_that_ends_within_a_message_still_has_the_one_inside() -> None:
    inside = pose()
    assert split(text()[:HEADER_BYTES] + inside) == [inside]


def test_splitter_skips_mavlink_1_and_unknown_ids() -> None:
    splitter = StreamSplitter()
    unknown = bytes([0xFD, 9, 0, 0, 0, 1, 1, 99, 0, 0]) + bytes(11)
    known = pose()
    assert splitter.feed(b"\xfe\x09\x00\x01\x01\x00" + bytes(11) + unknown + known) == [known]
    assert splitter.bad_bytes == 17 + 21


def test_every_message_has_a_class_and_uploads_come_last() -> None:
    assert PRIORITIES[message_id(pose())] is Priority.URGENT
    assert PRIORITIES[message_id(timesync())] is Priority.URGENT
    assert PRIORITIES[message_id(command())] is Priority.URGENT
    assert PRIORITIES[message_id(control())] is PRIORITIES[message_id(estimate())] is Priority.FAST_TELEMETRY
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
    return sum(PRIORITIES[message_id(message)] is Priority.FAST_TELEMETRY for message in gone)


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
    kept = CAPACITY_BYTES[Priority.FAST_TELEMETRY] // len(control())
    assert packer.refused == 3 + 10 - kept
    assert [packer.take() for _ in range(kept)] == telemetry[-kept:]


def test_packer_sends_the_urgent_between_the_pieces_of_a_long_message() -> None:
    packer = FramePacker()
    long = ftp(1)
    packer.offer(long)
    packer.offer(chunk())
    first = not_none(packer.take())
    packer.offer(pose())
    packer.offer(control())
    frames = [first, *(not_none(packer.take()) for _ in range(5))]
    assert [frame[0] for frame in frames] == [PIECE, MAGIC, MAGIC, PIECE, PIECE, MAGIC]
    assert [message_id(frames[k]) for k in (1, 2, 5)] == [138, 52100, 52111]
    assembler = Assembler()
    assert [assembler.receive(frames[k], 0) for k in (0, 3, 4)] == [None, None, long]
    assert packer.take() is None
    assert packer.packed == 4


def test_packer_that_drops_a_message_half_sent_goes_on_with_a_whole_one() -> None:
    packer = FramePacker(frame_bytes=FRAME_BYTES_MIN)
    telemetry = [control(k) for k in range(10)]
    packer.offer(telemetry[0])
    assembler = Assembler()
    assert assembler.receive(not_none(packer.take()), 0) is None
    for message in telemetry[1:]:
        packer.offer(message)
    out = []
    while (frame := packer.take()) is not None:
        assert len(frame) <= FRAME_BYTES_MIN
        out.append(assembler.receive(frame, 0))
    assert [message for message in out if message] == telemetry[10 - len(out) // 2 :]


def test_packer_takes_a_pose_longer_than_a_frame_as_any_urgent_message() -> None:
    covariance = CODEC.encode(m.AttPosMocap(1, (1.0, 0.0, 0.0, 0.0), 1.0, 2.0, 3.0, [1.0] * 21))
    packer, assembler, short = FramePacker(), Assembler(), pose()
    assert packer.offer(covariance)
    packer.offer(short)
    assert packer.take() == short
    assert [assembler.receive(not_none(packer.take()), 0) for _ in range(2)] == [None, covariance]
    assert packer.take() is None


@pytest.mark.parametrize("size", [FRAME_BYTES_MIN, 100, FRAME_BYTES])
@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.1, 0.5]),
    damage=st.sampled_from([0.0, 0.1]),
    duplicate=st.sampled_from([0.0, 0.3]),
    jitter=st.integers(0, 6),
)
def test_any_stream_of_messages_comes_out_whole_or_not_at_all(
    size, seed, loss, damage, duplicate, jitter
) -> None:
    rng = random.Random(seed)
    packer, assembler = FramePacker(frame_bytes=size), Assembler()
    makers = (pose, control, text, chunk, ftp, ftp)
    offered, air, at = [], [], 0
    for k in range(80):
        message = rng.choice(makers)(k + 1)
        offered += [message] if packer.offer(message) else []
        while (rng.random() < 0.7 or k == 79) and (frame := packer.take()) is not None:
            assert len(frame) <= size
            at += 1
            if rng.random() < loss:
                continue
            if rng.random() < damage:
                frame = bytearray(frame)
                for _ in range(rng.randint(1, 6)):
                    frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
            for _ in range(2 if rng.random() < duplicate else 1):
                air.append((at + rng.uniform(0, jitter), len(air), bytes(frame)))
    splitter, found = StreamSplitter(), []
    for _, _, frame in sorted(air):
        if frame[0] == PIECE:
            message = assembler.receive(frame, 0)
            assert message is None or message in offered
            frame = message or b""
        found += splitter.feed(frame)
    found += splitter.feed(bytes(MESSAGE_BYTES_MAX))
    assert set(found) <= set(offered)
    longs = [message for message in found if len(message) > size]
    assert len(longs) == len(set(longs))
    if not loss and not damage:
        missing = {message_id(message) for message in set(offered) - set(found)}
        assert missing <= {message_id(pose()), message_id(control())}  # the newest replaces the oldest
        assert assembler.broken == 0


def test_assembler_counts_a_message_once_whose_piece_is_lost_and_takes_the_next() -> None:
    assembler = Assembler()
    for piece in split_message(ftp(1), 7)[1:]:
        assert assembler.receive(piece, 1000) is None
    assembler.expire(1000 + PIECE_TIMEOUT_US - 1)
    assert assembler.broken == 0
    assembler.expire(1000 + PIECE_TIMEOUT_US)
    assembler.expire(1000 + 2 * PIECE_TIMEOUT_US)
    assert assembler.broken == 1
    assert [assembler.receive(piece, 0) for piece in split_message(ftp(2), 8)][-1] == ftp(2)
    assert [assembler.receive(piece, 500_000) for piece in split_message(ftp(2), 8)] == [
        None
    ] * 3  # twice on the way
    # The number again, long after: another message.
    again = [assembler.receive(piece, PIECE_TIMEOUT_US) for piece in split_message(ftp(3), 8)]
    assert again[-1] == ftp(3)


def test_assembler_keeps_few_messages_and_counts_the_oldest_as_broken() -> None:
    assembler = Assembler()
    pieces = [split_message(ftp(k), k) for k in range(PIECED_MESSAGES_MAX + 2)]
    for message in pieces:
        assembler.receive(message[0], 0)
    assert assembler.broken == 2
    assert [assembler.receive(piece, 0) for piece in pieces[-1][1:]][-1] == ftp(PIECED_MESSAGES_MAX + 1)


def test_assembler_takes_any_bytes() -> None:
    rng = random.Random(2)
    assembler = Assembler()
    for k in range(20_000):
        frame = bytes([PIECE]) + rng.randbytes(rng.choice((0, 1, 2, 3, 40, 115)))
        assert assembler.receive(frame, 1000 * k) is None
    assembler.expire(10**9)
    for number in range(256):
        assert [assembler.receive(piece, 10**9) for piece in split_message(ftp(number), number)][-1] == ftp(
            number
        )


def test_pieces_and_messages_begin_with_bytes_that_no_flip_of_seven_bits_mixes_up() -> None:
    assert PIECE ^ MAGIC == 0xFF
    assert -(-MESSAGE_BYTES_MAX // (FRAME_BYTES_MIN - PIECE_HEADER_BYTES)) <= 0x0F


def test_packer_for_too_small_a_frame_is_refused() -> None:
    with pytest.raises(ValueError, match=f"at least {FRAME_BYTES_MIN}, not 63"):
        FramePacker(frame_bytes=63)


def test_packer_for_no_pose_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        FramePacker(poses=0)
