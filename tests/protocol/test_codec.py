"""Bytes to messages and back, with pymavlink's own decoder as the oracle, and garbage."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec, decode_message
from trimtab.protocol.messages import Message, mavlink

RANGES = {
    "uint8_t": (0, 2**8 - 1),
    "int8_t": (-128, 127),
    "uint16_t": (0, 2**16 - 1),
    "int16_t": (-(2**15), 2**15 - 1),
    "uint32_t": (0, 2**32 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
    "uint64_t": (0, 2**64 - 1),
    "int64_t": (-(2**63), 2**63 - 1),
}


def draw_message(rng: random.Random, number: int) -> Message:
    """A message of this id with every field drawn, zeros among them so that payloads are cut."""
    kind = mavlink.mavlink_map[number]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))

    def value(form: str) -> float | int:
        if rng.random() < 0.2:
            return 0
        if form == "float":
            return struct.unpack("<f", struct.pack("<f", rng.uniform(-1e3, 1e3)))[0]
        return rng.randint(*RANGES[form])

    fields = []
    for name, form in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        count = lengths[name]
        if form == "char":
            fields.append(bytes(rng.randint(32, 126) for _ in range(rng.randint(0, count))))
        elif count:
            fields.append([value(form) for _ in range(count)])
        else:
            fields.append(value(form))
    return kind(*fields)


def fields_of(message: Message) -> list:
    values = [getattr(message, name) for name in message.fieldnames]
    return [list(value) if isinstance(value, list | tuple | bytes) else value for value in values]


@pytest.mark.parametrize("number", mavlink.mavlink_map)
def test_every_message_survives_both_ways_and_decodes_as_pymavlink_does(number: int) -> None:
    rng = random.Random(number)
    sender, receiver, oracle = Codec(1, 2), Codec(3, 4), mavlink.MAVLink(None)
    packer = mavlink.MAVLink(None, 1, 2)
    for _ in range(20):
        message = draw_message(rng, number)
        data = sender.encode(message)
        assert data == message.pack(packer)
        packer.seq = (packer.seq + 1) & 0xFF
        (found,) = receiver.decode(data)
        theirs = oracle.decode(bytearray(data))
        assert type(found) is type(message)
        assert fields_of(found) == fields_of(theirs) == fields_of(message)
        assert (found.get_srcSystem(), found.get_srcComponent()) == (1, 2)
        assert found.get_seq() == theirs.get_seq()
        assert found.get_crc() == theirs.get_crc()
    assert receiver.lost == receiver.repeated == receiver.bad_bytes == 0


def test_decode_byte_by_byte_gives_the_same_messages() -> None:
    rng = random.Random(1)
    sender, whole, single = Codec(1, 1), Codec(2, 2), Codec(2, 2)
    data = b"".join(sender.encode(draw_message(rng, number)) for number in mavlink.mavlink_map)
    expected = whole.decode(data)
    found = [message for k in range(len(data)) for message in single.decode(data[k : k + 1])]
    assert [message.get_msgbuf() for message in found] == [message.get_msgbuf() for message in expected]
    assert len(expected) == len(mavlink.mavlink_map)


@settings(max_examples=200)
@given(
    parts=st.lists(st.one_of(st.binary(max_size=60), st.integers(0, 2**16)), max_size=12),
    cuts=st.lists(st.integers(1, 80), max_size=30),
)
def test_messages_between_garbage_are_all_recovered(parts, cuts) -> None:
    sender, receiver = Codec(1, 1), Codec(2, 2)
    stream, sent = b"", []
    for part in parts:
        if isinstance(part, int):
            rng = random.Random(part)
            data = sender.encode(draw_message(rng, rng.choice(list(mavlink.mavlink_map))))
            sent.append(data)
            stream += data
        else:
            stream += part
    stream += bytes(300)  # what follows ends the wait for a message that a false header promised
    found, at = [], 0
    for cut in cuts:
        found += receiver.decode(stream[at : at + cut])
        at += cut
    found += receiver.decode(stream[at:])
    buffers = iter([bytes(message.get_msgbuf()) for message in found])
    assert all(data in buffers for data in sent)  # in order
    assert receiver.lost == 0


@settings(max_examples=300)
@given(data=st.binary(max_size=400), magic=st.booleans(), number=st.sampled_from(sorted(mavlink.mavlink_map)))
def test_arbitrary_bytes_never_raise(data: bytes, magic: bool, number: int) -> None:
    receiver = Codec(2, 2)
    if magic:
        data = bytes([0xFD, len(data) % 256, 0, 0, 0, 1, 1]) + number.to_bytes(3, "little") + data
    receiver.decode(data)
    receiver.decode(data[::-1])


@settings(max_examples=200)
@given(number=st.sampled_from(sorted(mavlink.mavlink_map)), payload=st.binary(max_size=255))
def test_any_payload_with_a_right_checksum_decodes(number: int, payload: bytes) -> None:
    """A checksum proves nothing about what is inside: text that is no text, NaN, other lengths."""
    header = bytes([0xFD, len(payload), 0, 0, 7, 1, 1]) + number.to_bytes(3, "little")
    decode_message(header + payload + b"\0\0")


def test_a_flipped_bit_costs_one_message_and_is_counted() -> None:
    rng = random.Random(3)
    sender = Codec(1, 1)
    frames = [sender.encode(draw_message(rng, 52100)) for _ in range(3)]
    for bit in range(0, 8 * len(frames[1]), 7):
        damaged = bytearray(frames[1])
        damaged[bit // 8] ^= 1 << bit % 8
        receiver = Codec(2, 2)
        found = receiver.decode(frames[0] + bytes(damaged) + frames[2] + bytes(300))
        assert [message.get_seq() for message in found] == [0, 2]
        assert receiver.lost == 1
        assert receiver.bad_bytes >= len(damaged)


def test_an_extension_that_we_do_not_know_is_cut_off() -> None:
    (message,) = Codec(2, 2).decode(_with_payload(111, bytes(range(1, 19))))
    assert isinstance(message, m.Timesync)
    assert message.tc1 == int.from_bytes(bytes(range(1, 9)), "little")


def test_a_signed_message_is_read_without_its_signature() -> None:
    sender = mavlink.MAVLink(None, 1, 1)
    sender.signing.secret_key = bytes(32)
    sender.signing.sign_outgoing = True
    data = m.Ping(5, 6, 0, 0).pack(sender)
    receiver = Codec(2, 2)
    (message,) = receiver.decode(data)
    assert isinstance(message, m.Ping)
    assert (message.time_usec, message.seq) == (5, 6)
    assert receiver.bad_bytes == 0


def test_private_message_of_another_version_is_counted_as_bad_checksum() -> None:
    data = bytearray(
        Codec(1, 1).encode(m.FcEstimate(1, (1, 2, 3), (0, 0, 0), (1, 0, 0, 0), (0, 0, 1), 1, (0, 0, 1)))
    )
    data[-1] ^= 0x5A
    receiver = Codec(2, 2)
    assert receiver.decode(bytes(data)) == []
    assert receiver.bad_checksums == 1


def test_lost_late_and_repeated_messages_are_told_apart() -> None:
    sender, receiver = Codec(1, 1), Codec(2, 2)
    frames = [sender.encode(m.Ping(k, k, 0, 0)) for k in range(600)]
    for k in (0, 1, 4):
        receiver.decode(frames[k])
    assert (receiver.lost, receiver.repeated) == (2, 0)
    receiver.decode(frames[2])
    assert (receiver.lost, receiver.repeated) == (1, 0)
    receiver.decode(frames[2])
    receiver.decode(frames[4])
    assert (receiver.lost, receiver.repeated) == (1, 2)
    for frame in frames[5:]:
        receiver.decode(frame)
    assert (receiver.lost, receiver.repeated) == (1, 2)
    assert receiver.received == 600 - 1 + 2


def test_senders_are_counted_apart() -> None:
    receiver = Codec(9, 9)
    one, two = Codec(1, 1), Codec(1, 68)
    for _ in range(5):
        receiver.decode(one.encode(m.Ping(0, 0, 0, 0)))
    receiver.decode(two.encode(m.Ping(0, 0, 0, 0)))
    receiver.decode(one.encode(m.Ping(0, 0, 0, 0)))
    assert receiver.lost == 0


def test_encode_is_deterministic_and_numbers_wrap() -> None:
    def run() -> list[bytes]:
        codec = Codec(1, 1)
        return [codec.encode(m.Ping(k, k, 0, 0)) for k in range(300)]

    first = run()
    assert first == run()
    assert [frame[4] for frame in first] == [k % 256 for k in range(300)]


@pytest.mark.parametrize(
    "message",
    [
        m.Ping(-1, 0, 0, 0),
        m.Ping(1.5, 0, 0, 0),  # pyright: ignore[reportArgumentType]  # not a whole number
        m.FcEstimate(0, (1e39, 0, 0), (0, 0, 0), (0, 0, 0, 0), (0, 0, 0), 0, (0, 0, 0)),
        m.FcEstimate(0, (1, 0), (0, 0, 0), (0, 0, 0, 0), (0, 0, 0), 0, (0, 0, 0)),
    ],
)
def test_encode_of_a_value_that_does_not_fit_raises_value_error_and_uses_no_number(message: Message) -> None:
    codec = Codec(1, 1)
    with pytest.raises(ValueError, match=message.get_type()):
        codec.encode(message)
    assert codec.encode(m.Ping(0, 0, 0, 0))[4] == 0


@pytest.mark.parametrize("address", [(-1, 0), (0, 256)])
def test_codec_with_an_address_out_of_range_is_refused(address) -> None:
    with pytest.raises(ValueError, match=r"0\.\.255"):
        Codec(*address)


def _with_payload(number: int, payload: bytes) -> bytes:
    from fastcrc.crc16 import mcrf4xx

    head = bytes([len(payload), 0, 0, 0, 1, 1]) + number.to_bytes(3, "little") + payload
    seed = bytes([mavlink.mavlink_map[number].crc_extra])
    return b"\xfd" + head + mcrf4xx(head + seed).to_bytes(2, "little")


def test_signed_messages_of_a_stock_client_are_understood_and_forged_ones_lock_nobody_out() -> None:
    client = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    client.signing.secret_key = bytes(range(32))
    client.signing.timestamp = 1_000
    client.signing.sign_outgoing = True
    receiver = Codec(*m.VEHICLE)

    def signed(command: int) -> bytes:
        return mavlink.MAVLink_command_long_message(1, 1, command, 0, *[0.5] * 7).pack(client)

    first, second = signed(400), signed(300)
    assert first[2] == mavlink.MAVLINK_IFLAG_SIGNED
    assert len(first) == len(Codec(255, 190).encode(m.CommandLong(1, 1, 400, 0, *[0.5] * 7))) + 13
    forged = bytearray(signed(21))
    forged[-12:-6] = b"\xff" * 6  # stamped far in the future, under a signature that is now wrong
    unsigned = Codec(255, 190).encode(m.Timesync(0, 5))
    found = receiver.decode(first + bytes(forged) + second + unsigned)
    assert [getattr(message, "command", None) for message in found] == [400, 21, 300, None]
    assert receiver.bad_bytes == 0
