"""The codec with keys: what it signs, what it accepts, and that nothing changes without a key."""

from __future__ import annotations

from typing import Any

import pytest

from trimtab.protocol import messages as m
from trimtab.protocol import unsigned
from trimtab.protocol.codec import Codec
from trimtab.protocol.generated.frames import MESSAGES
from trimtab.protocol.messages import Message, mavlink
from trimtab.protocol.signing import Signer, SigningKey, Verdict, Verifier

KEY, OTHER = SigningKey(bytes(range(32))), SigningKey(bytes(range(1, 33)))
EPOCH = 38_000_000_000_000
ARM = m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, *[0.0] * 6)
POSE = m.AttPosMocap(1000, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, -1.0)


def host(key: SigningKey | None = KEY, epoch: int = EPOCH) -> Codec:
    codec = Codec(*m.HOST, accepts_unsigned=unsigned.host_accepts)
    if key is not None:
        codec.signer = Signer(key, link_id=0, epoch=epoch)
        codec.verifier = Verifier(key, epoch=epoch)
    return codec


def vehicle(key: SigningKey = KEY, epoch: int = EPOCH) -> Codec:
    codec = Codec(*m.VEHICLE, accepts_unsigned=unsigned.vehicle_accepts)
    codec.signer = Signer(key, link_id=0, epoch=epoch)
    codec.verifier = Verifier(key, epoch=epoch)
    return codec


def test_signed_message_is_13_bytes_longer_and_arrives() -> None:
    sent = host().encode(ARM)
    assert len(sent) == len(Codec(*m.HOST).encode(ARM)) + 13
    (message,) = vehicle().decode(sent)
    assert isinstance(message, m.CommandLong)
    assert message.param1 == 1.0


def test_message_signed_with_another_key_is_not_decoded_and_moves_no_counter() -> None:
    receiver = vehicle()
    assert receiver.decode(host(OTHER).encode(ARM)) == []
    assert [verdict for verdict, _ in receiver.refused] == [Verdict.BAD_SIGNATURE]
    assert (receiver.received, receiver.lost) == (0, 0)


@pytest.mark.parametrize(
    "message", [ARM, POSE, m.UploadAbort(1, bytes(32)), m.FileTransfer(0, 1, 1, bytes(251))]
)
def test_vehicle_refuses_unsigned_messages_that_act(message: Message) -> None:
    receiver = vehicle()
    assert receiver.decode(host(None).encode(message)) == []
    assert [verdict for verdict, _ in receiver.refused] == [Verdict.UNSIGNED]


@pytest.mark.parametrize("number", sorted(unsigned.TO_VEHICLE))
def test_vehicle_reads_unsigned_messages_of_the_table(number: int) -> None:
    kind = mavlink.mavlink_map[number]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    fields: list[Any] = [
        b"a" if form == "char" else [1] * lengths[name] if lengths[name] else 1
        for name, form in zip(kind.fieldnames, kind.fieldtypes, strict=True)
    ]
    (message,) = vehicle().decode(host(None).encode(kind(*fields)))
    assert message.id == number


def test_vehicle_reads_unsigned_commands_that_only_ask() -> None:
    for number in unsigned.COMMANDS_TO_VEHICLE:
        ask = m.CommandLong(1, 1, number, 0, *[0.0] * 7)
        ask_int = m.CommandInt(1, 1, 0, number, 0, 0, *[0.0] * 4, x=0, y=0, z=0.0)
        for message in (ask, ask_int):
            assert len(vehicle().decode(host(None).encode(message))) == 1


def test_command_number_of_a_trimmed_payload_is_read() -> None:
    land = host(None).encode(m.CommandLong(0, 0, 21, 0, *[0.0] * 7))
    assert land[1] == 29  # the high byte of the number is trimmed
    assert unsigned.command_number(land) == 21
    nothing = host(None).encode(m.CommandLong(0, 0, 0, 0, *[0.0] * 7))
    assert unsigned.command_number(nothing) == 0


def test_vehicle_accepts_unsigned_nothing_that_acts() -> None:
    names = {MESSAGES[number][0] for number in unsigned.TO_VEHICLE}
    assert not [name for name in names if name.startswith(("SET_", "UPLOAD_", "PARAM_SET", "ATT_", "FILE_"))]


def test_host_with_a_key_reads_only_the_radios_unsigned() -> None:
    receiver = host()
    plain = Codec(*m.VEHICLE)
    stats = m.RadioStats(1, 2, 3, 4, 5, 6, 7, 8)
    data = plain.encode(m.vehicle_heartbeat(1, armed=False)) + plain.encode(m.Timesync(1, 2))
    assert receiver.decode(data) == []
    assert len(receiver.decode(Codec(*m.VEHICLE_RADIO).encode(stats))) == 1


def test_host_without_a_key_reads_a_signing_vehicle() -> None:
    (message,) = host(None).decode(vehicle().encode(m.vehicle_heartbeat(1, armed=False)))
    assert isinstance(message, m.Heartbeat)


def test_each_end_follows_the_newest_timestamp_of_the_other() -> None:
    year = 365 * 24 * 3600 * 100_000
    ahead, behind = vehicle(epoch=EPOCH + year), host()
    assert ahead.decode(behind.encode(ARM)) == []
    assert ahead.refused[0][0] is Verdict.TOO_OLD
    assert len(behind.decode(ahead.encode(m.vehicle_heartbeat(1, armed=False)))) == 1
    assert len(ahead.decode(behind.encode(ARM))) == 1


def test_refused_messages_of_an_earlier_call_are_forgotten() -> None:
    receiver = vehicle()
    receiver.decode(host(None).encode(ARM))
    receiver.decode(host().encode(ARM))
    assert receiver.refused == []
