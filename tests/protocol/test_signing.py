"""Signatures, with pymavlink as the oracle both ways: replays, reordering, forged and damaged messages."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trimtab.protocol import messages as m
from trimtab.protocol.messages import mavlink
from trimtab.protocol.signing import (
    NEW_STREAM_US,
    STREAMS_MAX,
    TIMESTAMP_MAX,
    UNIT_US,
    WINDOW_MESSAGES,
    WINDOW_US,
    Signer,
    SigningKey,
    Verdict,
    Verifier,
    key_text,
)
from trimtab.protocol.stream import split

KEY = SigningKey(bytes(range(32)))
OTHER = SigningKey(bytes(range(1, 33)))
NOW = 38_000_000_000_000
"""A timestamp in the year 2027."""
SECOND = 1_000_000 // UNIT_US
WINDOW, NEW_STREAM = WINDOW_US // UNIT_US, NEW_STREAM_US // UNIT_US


def signed(timestamp: int, *, key: SigningKey = KEY, system: int = 255, link_id: int = 0) -> bytes:
    """A PING that pymavlink signed."""
    sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
    sender.signing.secret_key = key.secret
    sender.signing.link_id = link_id
    sender.signing.timestamp = timestamp
    sender.signing.sign_outgoing = True
    return bytes(m.Ping(1_000_000_007, 6, 0, 0).pack(sender))


def verifier(**options: int) -> Verifier:
    return Verifier(KEY, **{"epoch": NOW, **options})


def test_pymavlinks_signature_is_accepted_at_its_timestamp() -> None:
    one = verifier()
    assert one.check(signed(NOW + 5, link_id=3)) is Verdict.ACCEPTED
    assert one.newest == NOW + 5
    assert one.counts[Verdict.ACCEPTED] == 1


@pytest.mark.parametrize("number", [0, 4, 110, 253, 52100])
def test_pymavlink_accepts_our_signature_and_makes_the_same_bytes(number: int) -> None:
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    packer.signing.secret_key = KEY.secret
    packer.signing.sign_outgoing = True
    packer.signing.link_id = 7
    packer.signing.timestamp = NOW
    signer = Signer(KEY, link_id=7, epoch=NOW)
    oracle = mavlink.MAVLink(None)
    oracle.signing.secret_key = KEY.secret
    kind = mavlink.mavlink_map[number]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    values: list[Any] = [
        b"text" if form == "char" else [1] * lengths[name] if lengths[name] else 1
        for name, form in zip(kind.fieldnames, kind.fieldtypes, strict=True)
    ]
    for _ in range(3):
        theirs = bytes(kind(*values).pack(packer))
        ours = theirs[:-13] + signer.sign(theirs[:-13])
        assert ours == theirs
        assert oracle.check_signature(bytearray(ours), 1, 1)


def test_forged_message_from_the_future_locks_nobody_out() -> None:
    one = verifier()
    assert one.check(signed(NOW)) is Verdict.ACCEPTED
    assert one.check(signed(NOW + 10**9, key=OTHER)) is Verdict.BAD_SIGNATURE
    assert one.check(signed(NOW + 10**9, key=OTHER, system=9)) is Verdict.BAD_SIGNATURE
    assert (one.newest, one.time, one.streams) == (NOW, NOW, 1)
    assert one.check(signed(NOW + 1)) is Verdict.ACCEPTED
    assert one.check(signed(NOW + 1, system=9)) is Verdict.ACCEPTED


def test_station_with_a_clock_a_year_ahead_locks_no_other_one_out() -> None:
    year = 365 * 24 * 3600 * SECOND
    one = verifier()
    assert one.check(signed(NOW, system=1)) is Verdict.ACCEPTED
    assert one.check(signed(NOW + year, system=2)) is Verdict.ACCEPTED
    assert one.check(signed(NOW + 1, system=1)) is Verdict.ACCEPTED
    assert one.check(signed(NOW + 1, system=3)) is Verdict.ACCEPTED
    assert one.time == NOW + NEW_STREAM


def test_signer_that_follows_the_newest_timestamp_is_accepted_as_a_new_stream() -> None:
    one = verifier()
    for number in range(100):
        one.check(signed(NOW + 10**12 + number, system=2))
    late = Signer(KEY, link_id=0, epoch=NOW)
    message = signed(NOW)[:-13]
    assert one.check(message + late.sign(message)) is Verdict.TOO_OLD
    late.follow(one.newest)
    assert one.check(message + late.sign(message)) is Verdict.ACCEPTED


def test_timestamp_near_the_end_of_the_counter_is_refused_and_moves_nothing() -> None:
    one = verifier()
    assert one.check(signed(TIMESTAMP_MAX + 1)) is Verdict.TOO_NEW
    assert (one.newest, one.time) == (0, NOW)


def test_repeated_message_is_refused() -> None:
    one = verifier()
    message = signed(NOW)
    assert [one.check(message), one.check(message)] == [Verdict.ACCEPTED, Verdict.REPLAYED]


def test_overtaken_message_is_accepted_once_within_the_window() -> None:
    one = verifier()
    one.check(signed(NOW))
    assert one.check(signed(NOW - WINDOW)) is Verdict.ACCEPTED
    assert one.check(signed(NOW - WINDOW)) is Verdict.REPLAYED
    assert one.check(signed(NOW - WINDOW - 1)) is Verdict.TOO_OLD


def test_window_remembers_a_bounded_number_of_messages() -> None:
    one = verifier()
    for number in range(WINDOW_MESSAGES + 1):
        assert one.check(signed(NOW + 2 * number)) is Verdict.ACCEPTED
    assert one.check(signed(NOW)) is Verdict.TOO_OLD
    assert one.check(signed(NOW + 1)) is Verdict.ACCEPTED
    assert one.check(signed(NOW - 1)) is Verdict.TOO_OLD


def test_new_stream_may_be_a_minute_old_and_no_more() -> None:
    one = verifier()
    assert one.check(signed(NOW - NEW_STREAM - 1)) is Verdict.TOO_OLD
    assert one.check(signed(NOW - NEW_STREAM)) is Verdict.ACCEPTED
    one.advance(5_000_000)
    assert one.check(signed(NOW - NEW_STREAM + 5 * SECOND - 1, system=4)) is Verdict.TOO_OLD
    assert one.check(signed(NOW - NEW_STREAM + 5 * SECOND, system=4)) is Verdict.ACCEPTED


def test_nothing_up_to_the_floor_of_an_earlier_run_is_accepted() -> None:
    one = verifier(floor=NOW)
    assert one.check(signed(NOW)) is Verdict.TOO_OLD
    assert one.check(signed(NOW + 1)) is Verdict.ACCEPTED
    assert one.check(signed(NOW)) is Verdict.TOO_OLD


def test_forgotten_stream_cannot_be_replayed() -> None:
    one = verifier()
    messages = [signed(NOW + number, system=number) for number in range(1, STREAMS_MAX + 2)]
    assert [one.check(message) for message in messages] == [Verdict.ACCEPTED] * len(messages)
    assert one.streams == STREAMS_MAX
    assert one.check(messages[0]) is Verdict.TOO_OLD
    assert [one.check(message) for message in messages[1:]] == [Verdict.REPLAYED] * STREAMS_MAX


@pytest.mark.parametrize("bit", range(0, 8 * len(signed(NOW))))
def test_any_flipped_bit_is_refused(bit: int) -> None:
    message = bytearray(signed(NOW))
    message[bit // 8] ^= 1 << bit % 8
    verdict = verifier().check(bytes(message))
    assert verdict is (Verdict.UNSIGNED if bit == 16 else Verdict.BAD_SIGNATURE)


def test_truncated_signature_is_no_message() -> None:
    message = signed(NOW)
    for missing in range(1, 14):
        assert split(message[:-missing]) == []


def test_unsigned_message_is_told_apart() -> None:
    unsigned = bytes(m.Ping(1, 2, 0, 0).pack(mavlink.MAVLink(None, 255, 190)))
    one = verifier()
    assert one.check(unsigned) is Verdict.UNSIGNED
    assert one.counts[Verdict.UNSIGNED] == 1


def test_signer_never_repeats_a_timestamp_and_keeps_up_with_its_clock() -> None:
    signer = Signer(KEY, link_id=0, epoch=NOW)
    message = signed(NOW)[:-13]
    stamps = []
    for now_us in (0, 0, 5, 10, 1_000_000, 10):
        signer.advance(now_us)
        stamps.append(int.from_bytes(signer.sign(message)[1:7], "little"))
    assert stamps == [NOW, NOW + 1, NOW + 2, NOW + 3, NOW + SECOND, NOW + SECOND + 1]


def test_signer_gives_messages_their_own_link_ids() -> None:
    signer = Signer(KEY, link_id=9, epoch=NOW, links={m.Heartbeat.id: 2})
    ping = signed(NOW)[:-13]
    heartbeat = bytes(m.host_heartbeat().pack(mavlink.MAVLink(None, 1, 1)))
    assert (signer.sign(ping)[0], signer.sign(heartbeat)[0]) == (9, 2)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32), lag=st.integers(1, WINDOW_MESSAGES // 2))
def test_every_genuine_message_is_accepted_exactly_once_in_any_order_within_the_window(
    seed: int, lag: int
) -> None:
    rng = random.Random(seed)
    sender = Signer(KEY, link_id=0, epoch=NOW)
    body = signed(NOW)[:-13]
    sent = []
    for number in range(150):
        sender.advance(number * 1000)
        sent.append(body + sender.sign(body))
    order = sorted(range(len(sent)), key=lambda number: number + rng.uniform(0, lag))
    arriving = [number for number in order for _ in range(rng.choice((1, 1, 2)))]
    one = verifier()
    accepted = [number for number in arriving if one.check(sent[number]) is Verdict.ACCEPTED]
    assert sorted(accepted) == list(range(len(sent)))


def test_key_text_is_the_passphrase_of_ground_stations() -> None:
    import hashlib

    text = key_text(bytes(range(32)))
    assert text == bytes(range(32)).hex()
    assert SigningKey.from_text(text).secret == hashlib.sha256(text.encode()).digest()


@pytest.mark.parametrize("text", ["", "0" * 63, "0" * 65, "G" * 64, "A" * 64, "0" * 64 + "\n"])
def test_key_text_of_another_form_is_refused_without_repeating_it(text: str) -> None:
    with pytest.raises(ValueError, match="64 hexadecimal digits") as caught:
        SigningKey.from_text(text)
    assert not text or text not in str(caught.value)


@pytest.mark.parametrize("secret", [b"", bytes(31), bytes(32), bytes(range(33))])
def test_key_of_wrong_length_or_zeros_is_refused(secret: bytes) -> None:
    with pytest.raises(ValueError, match="key"):
        SigningKey(secret)


def test_key_does_not_show_its_secret() -> None:
    assert KEY.secret.hex() not in repr(KEY)
    assert str(KEY.secret) not in repr(KEY)


@pytest.mark.parametrize("link_id", [-1, 256])
def test_link_id_out_of_range_is_refused(link_id: int) -> None:
    with pytest.raises(ValueError, match=r"0\.\.255"):
        Signer(KEY, link_id=link_id, epoch=NOW)
