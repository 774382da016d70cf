"""A vehicle with a key, by its bytes: what it obeys, how the key is set up, and what a power cycle leaves."""

import random

import pytest
from fastcrc.crc16 import mcrf4xx

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.services.signing_service import (
    BAD_TIME,
    ONLY_BY_CABLE,
    ONLY_IN_STANDBY,
    TEXTS,
)
from trimtab.firmware_model.storage.flash import Flash, PowerCut
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.generated.frames import MESSAGES
from trimtab.protocol.messages import HOST
from trimtab.protocol.signing import TIMESTAMP_MAX, Signer, SigningKey, Verdict, Verifier
from trimtab.protocol.stream import message_id

KEY, OTHER = SigningKey(bytes(range(32))), SigningKey(bytes(range(1, 33)))
NOW = 38_000_000_000_000
REAL32 = 9
INSTALLED, REMOVED = "signing key installed", "signing key removed"
ARM, FLIGHT_TERMINATION, LAND = 400, 185, 21


def keyed_store(key=KEY, used=NOW):
    store = ReferenceStore()
    store.signing.keep(key, used)
    return store


def sign(line, key=KEY, epoch=NOW + 100):
    """Give the host of a line a key; it also verifies what it hears."""
    codec = line.codecs.setdefault(HOST, Codec(*HOST))
    codec.signer = Signer(key, link_id=0, epoch=epoch)
    line.ears.signer = codec.signer  # it follows the vehicle's clock
    line.ears.verifier = Verifier(key, epoch=epoch)


def setup(key, timestamp=NOW):
    return m.SetupSigning(1, 1, list(key.secret) if key else [0] * 32, timestamp)


def commanded(line):
    return [(ack.command, ack.result) for ack in line.received(m.CommandAck)]


def parameter(name, value):
    return m.ParamSet(1, 1, name.encode(), value, REAL32)


def test_unsigned_command_is_not_obeyed_and_the_station_is_told_once(make_line):
    line = make_line(store=keyed_store())
    for _ in range(20):
        line.command(FLIGHT_TERMINATION, 1.0)
        line.run(0.1)
    assert commanded(line) == []
    assert line.flight.state is State.STANDBY
    assert line.texts().count(TEXTS[Verdict.UNSIGNED]) == 1
    line.run(5.0)
    line.command(LAND)
    line.run(0.2)
    assert line.texts().count(TEXTS[Verdict.UNSIGNED]) == 2


def test_command_signed_with_another_key_is_not_obeyed_and_the_station_is_told(make_line):
    line = make_line(store=keyed_store())
    sign(line, OTHER)
    line.ears.verifier = None
    line.command(FLIGHT_TERMINATION, 1.0)
    line.run(0.3)
    assert commanded(line) == []
    assert TEXTS[Verdict.BAD_SIGNATURE] in line.texts()


def test_signed_command_is_answered_and_all_telemetry_is_signed(make_line):
    line = make_line(store=keyed_store())
    sign(line)
    line.command(LAND)
    line.run(1.2)
    assert [command for command, _ in commanded(line)] == [LAND]
    assert line.ears.refused == []
    assert line.ears.verifier.counts[Verdict.ACCEPTED] > 200
    assert sum(line.ears.verifier.counts.values()) == line.ears.verifier.counts[Verdict.ACCEPTED]


def test_recorded_command_is_obeyed_once_also_after_a_power_cycle(make_line):
    line = make_line(store=keyed_store())
    sign(line)
    line.run(0.5)
    recorded = line.codecs[HOST].encode(m.CommandLong(1, 1, LAND, 0, *[0.0] * 7))
    for _ in range(3):
        line.port.write(recorded, line.now_us)
        line.run(0.1)
    assert len(commanded(line)) == 1
    again = make_line(store=ReferenceStore(Flash(bytearray(line.store.flash.image))))
    again.ears.verifier = Verifier(KEY, epoch=NOW)
    again.port.write(recorded, again.now_us)
    again.run(0.5)
    assert commanded(again) == []


def test_station_is_heard_at_once_after_a_quick_power_cycle(make_line):
    line = make_line(store=keyed_store())
    sign(line)
    line.command(LAND)
    line.run(0.3)
    again = make_line(store=ReferenceStore(Flash(bytearray(line.store.flash.image))))
    sign(again, epoch=NOW + 200_000)  # less than the vehicle counts as used
    again.command(LAND)
    again.run(0.3)
    assert commanded(again) == []
    again.command(LAND)  # it has heard the vehicle's clock by now
    again.run(0.3)
    assert [command for command, _ in commanded(again)] == [LAND]


def test_reading_works_without_a_key(make_line):
    line = make_line(store=keyed_store())
    line.send(m.ParamRequestRead(1, 1, b"MASS", -1), m.Timesync(0, 5), m.Ping(1, 2, 0, 0))
    line.command(512, m.AutopilotVersion.id)
    line.run(0.3)
    for kind in (m.ParamValue, m.Timesync, m.Ping, m.AutopilotVersion):
        assert len(line.received(kind)) == 1
    assert TEXTS[Verdict.UNSIGNED] not in line.texts()


def test_parameter_is_set_only_by_a_signed_message(make_line):
    line = make_line(store=keyed_store())
    line.send(parameter("HOLD_S", 2.5))
    line.run(0.2)
    assert line.flight.parameters["HOLD_S"] == 1.0
    sign(line)
    line.send(parameter("HOLD_S", 2.5))
    line.run(0.2)
    assert line.flight.parameters["HOLD_S"] == 2.5


def test_unsigned_messages_do_not_keep_the_link_alive(make_line):
    line = make_line(store=keyed_store())
    for _ in range(40):
        line.send(m.host_heartbeat())
        line.run(0.1)
    line.run(0.2)
    assert line.flight.flight.conditions & 1 << _bit("LINK_LOST")
    sign(line)
    line.send(m.host_heartbeat())
    line.run(0.1)
    assert not line.flight.flight.conditions & 1 << _bit("LINK_LOST")


def _bit(name):
    from trimtab.firmware_model.flight.failsafe import Failsafe

    return int(Failsafe[name])


def test_unsigned_pose_is_not_used(make_line):
    line = make_line(store=keyed_store())
    line.run(0.3)
    line.send(m.AttPosMocap(250_000, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0))
    line.run(0.1)
    assert line.flight.flight.poses.used == 0
    sign(line)
    line.send(m.AttPosMocap(350_000, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0))
    line.run(0.1)
    assert line.flight.flight.poses.used == 1


def test_key_is_installed_by_cable_and_outlives_a_power_cycle(make_line):
    line = make_line(wired=True)
    line.run(0.5)
    line.send(setup(KEY))
    line.run(0.2)
    assert INSTALLED in line.texts()
    assert line.store.signing.key == KEY
    line.command(LAND)
    line.run(0.2)
    assert commanded(line) == []
    sign(line)
    line.command(LAND)
    line.run(0.2)
    assert [command for command, _ in commanded(line)] == [LAND]
    again = ReferenceStore(Flash(bytearray(line.store.flash.image)))
    assert again.signing.key == KEY


def test_key_is_not_installed_over_a_radio(make_line):
    line = make_line()
    line.run(0.5)
    line.send(setup(KEY), setup(KEY))
    line.run(0.2)
    assert line.store.signing.key is None
    assert line.texts().count(ONLY_BY_CABLE) == 1


def test_key_is_neither_replaced_nor_removed_over_a_radio_even_with_the_key(make_line):
    line = make_line(store=keyed_store())
    sign(line)
    line.run(0.5)
    line.send(setup(OTHER), setup(None))
    line.run(0.2)
    assert line.store.signing.key == KEY
    assert ONLY_BY_CABLE in line.texts()


def test_key_is_not_changed_before_standby(make_line):
    line = make_line(wired=True)
    line.run(0.1)
    assert line.flight.state is State.BOOT
    line.send(setup(KEY))
    line.run(0.05)
    assert line.store.signing.key is None
    line.run(0.3)
    assert ONLY_IN_STANDBY in line.texts()


def test_lost_key_is_replaced_by_cable_without_it(make_line):
    line = make_line(store=keyed_store(OTHER), wired=True)
    line.run(0.5)
    line.send(setup(KEY))
    line.run(0.2)
    assert line.store.signing.key == KEY


def test_key_of_zeros_removes_the_key(make_line):
    line = make_line(store=keyed_store(), wired=True)
    line.run(0.5)
    line.send(setup(None, 0))
    line.run(0.2)
    assert REMOVED in line.texts()
    assert line.store.signing.key is None
    line.command(LAND)
    line.run(0.2)
    assert [command for command, _ in commanded(line)] == [LAND]


def test_same_key_again_keeps_recorded_messages_refused(make_line):
    line = make_line(store=keyed_store(), wired=True)
    sign(line)
    line.run(0.5)
    recorded = line.codecs[HOST].encode(m.CommandLong(1, 1, LAND, 0, *[0.0] * 7))
    line.port.write(recorded, line.now_us)
    line.run(0.1)
    line.codecs[HOST].signer = None
    written = line.store.flash.written
    line.send(setup(KEY, 5))
    line.run(0.1)
    line.port.write(recorded, line.now_us)
    line.run(0.1)
    assert len(commanded(line)) == 1
    assert line.store.flash.written - written <= 12
    assert INSTALLED in line.texts()


def test_set_up_with_a_time_near_the_end_of_the_counter_is_refused(make_line):
    line = make_line(wired=True)
    line.run(0.5)
    line.send(setup(KEY, TIMESTAMP_MAX + 1))
    line.run(0.2)
    assert line.store.signing.key is None
    assert BAD_TIME in line.texts()


@pytest.mark.parametrize(("required", "keyed"), [(0.0, False), (1.0, False), (1.0, True)])
def test_arming_needs_a_key_where_signing_is_required(make_session, required, keyed):
    store = keyed_store() if keyed else ReferenceStore()
    session = make_session(store=store, parameters={"SIGN_REQUIRED": required})
    if keyed:
        session.host.signer = Signer(KEY, link_id=0, epoch=NOW + 100)
    session.run(1.5)
    session.command(ARM, 1.0)
    session.run(0.2)
    refused = required > 0.0 and not keyed
    assert (session.flight.state is State.ARMED) is not refused
    assert any("no signing key: install one" in text for text in session.texts()) is refused


def test_texts_fit_one_message():
    for text in (*TEXTS.values(), ONLY_BY_CABLE, ONLY_IN_STANDBY, BAD_TIME):
        assert len(text) <= 50


def test_altered_messages_with_a_correct_checksum_change_nothing(make_line):
    """An attacker alters recorded signed messages, corrects the checksum, and adds unsigned ones."""
    line = make_line(store=keyed_store())
    sign(line)
    line.run(0.5)
    before, now = dict(line.flight.parameters), line.flight.flight.poses.used
    encode = line.codecs[HOST].encode
    originals = [
        encode(parameter("HOLD_S", 2.5)),
        encode(m.CommandLong(1, 1, ARM, 0, 1.0, 21196.0, *[0.0] * 5)),
        encode(m.AttPosMocap(490_000, [1.0, 0.0, 0.0, 0.0], 0.1, 0.0, -1.0)),
        encode(m.UploadBegin(1000, 1, 1, 86, 1, list(range(32)))),
    ]
    rng = random.Random(20_261)
    for _ in range(1_500):
        altered = bytearray(rng.choice(originals))
        for _ in range(rng.randint(1, 3)):
            altered[rng.randrange(1, len(altered))] ^= 1 << rng.randrange(8)
        seed = MESSAGES.get(message_id(bytes(altered)))
        end = 10 + altered[1]
        if seed is not None and end + 2 <= len(altered):
            crc = mcrf4xx(bytes(altered[1:end]) + bytes([seed[1]]))
            altered[end : end + 2] = crc.to_bytes(2, "little")
        if bytes(altered) in originals:
            continue  # a change of the checksum alone, corrected
        line.port.write(bytes(altered), line.now_us)
        line.run(0.003)
    assert line.ears.verifier.counts[Verdict.ACCEPTED] > 0
    assert dict(line.flight.parameters) == before
    assert line.flight.flight.poses.used == now
    assert line.flight.state is State.STANDBY
    assert commanded(line) == []
    assert line.received(m.UploadStatus) == []
    line.run(0.1)
    line.command(LAND)
    line.run(0.2)
    assert [command for command, _ in commanded(line)] == [LAND]


def test_message_is_obeyed_only_once_its_timestamp_is_in_memory(make_line):
    line = make_line(store=keyed_store())
    sign(line, epoch=NOW + 60_000_000)  # ten minutes ahead of what is in memory
    line.run(0.5)
    line.send(parameter("HOLD_S", 2.5))
    line.store.flash.cut_after(0)
    with pytest.raises(PowerCut):
        line.run(0.2)
    assert line.flight.parameters["HOLD_S"] == 1.0


def test_timestamps_of_sent_messages_are_not_used_again_after_a_power_cycle(make_line):
    line = make_line(store=keyed_store())
    line.ears.verifier = Verifier(KEY, epoch=NOW)
    line.run(0.3)
    again = make_line(store=ReferenceStore(Flash(bytearray(line.store.flash.image))))
    again.ears.verifier = line.ears.verifier  # it remembers the stream
    again.run(0.3)
    assert again.ears.verifier.counts[Verdict.ACCEPTED] > 50
    assert again.ears.verifier.counts[Verdict.ACCEPTED] == sum(again.ears.verifier.counts.values())
