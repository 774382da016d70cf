"""The flight processor by its bytes: a host's view over two radios, lossy air and finite buffers."""

import itertools
import math
import random
import struct
from importlib.metadata import version as package_version

import pytest

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.flight.verdict import Reason
from trimtab.firmware_model.law.feedforward import OPEN_REGION
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import FeedForward, Kind, Node, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, UploadResult, mavlink
from trimtab.protocol.parameter_wire import INT32, REAL32, decode, encode
from trimtab.protocol.parameters import DEFAULTS, PARAMETERS, float32
from trimtab.protocol.telemetry import IntervalDecoder
from trimtab.protocol.upload import UploadSender

VEHICLE_ID = "0123456789ab"
PLANNED = [state for state in State if state not in (State.FAILSAFE, State.OFFBOARD)]
"""What a flight along a reference goes through, in order."""


def test_session_over_bytes_flies_every_phase(flown):
    assert flown.seen == [*PLANNED, State.STANDBY]
    assert flown.sender.state.name == "DONE"
    assert flown.body.p[2] == 0.0


def test_telemetry_comes_at_its_rates(flown):
    seconds = flown.now_us * 1e-6
    assert len(flown.received(m.FcControl)) == pytest.approx(100 * seconds, rel=0.02)
    assert len(flown.received(m.FcEstimate)) == pytest.approx(100 * seconds, rel=0.02)
    assert len(flown.received(m.Heartbeat)) == pytest.approx(seconds, abs=1.5)
    changes = len(flown.seen)
    assert 10 * seconds - 3 <= len(flown.received(m.FcStatus)) <= 10 * seconds + changes + 10
    assert flown.host.lost == 0


def test_observer_is_reported_while_it_is_on_ahead_of_the_control_message_of_its_tick(make_session, flown):
    assert not flown.received(m.FcObserver)
    session = make_session(parameters={"OBS_GAIN": 2.0})
    session.run(1.0)
    kinds = (m.FcControl, m.FcEstimate, m.FcObserver)
    order = [message for message in session.inbox if isinstance(message, kinds)]
    first = next(k for k, message in enumerate(order) if isinstance(message, m.FcEstimate))
    whole = order[first : first + 3 * ((len(order) - first) // 3)]
    assert len(whole) > 200
    for k in range(0, len(whole), 3):
        assert [type(message) for message in whole[k : k + 3]] == [m.FcEstimate, m.FcObserver, m.FcControl]
        assert len({message.tick for message in whole[k : k + 3]}) == 1


def test_running_sums_give_the_mean_of_what_the_motors_got(flown):
    decoder = IntervalDecoder()
    intervals = [i for i in map(decoder.push, flown.received(m.FcControl)) if i is not None]
    assert len(intervals) > 1_000
    for interval in intervals[500:1_000:7]:
        got = flown.commands[interval.start_tick : interval.end_tick]
        for k in range(4):
            mean = sum(row[k] for row in got) / len(got)
            assert interval.motor_mean[k] == pytest.approx(mean, abs=1e-5)


def test_status_marks_phases_and_the_reference_on_board(flown, make_blob):
    by_state = {}
    for status in flown.received(m.FcStatus):
        by_state.setdefault(State(status.state), status)
    assert set(by_state) == set(PLANNED)
    tracking = by_state[State.TRACKING]
    assert tracking.reference_tick == tracking.state_tick
    assert by_state[State.TAKEOFF].reference_tick == m.NO_TICK
    assert bytes(tracking.reference_id).hex() == make_blob().id
    assert bytes(tracking.vehicle_id).hex() == VEHICLE_ID
    last = flown.received(m.FcStatus)[-1]
    assert (last.uart_overruns, last.loop_overruns, last.bad_bytes) == (0, 0, 0)
    assert last.battery_mv == 16_800
    assert last.poses_used > 500


def test_tracking_starts_at_the_reference_of_the_status_tick(flown):
    status = next(s for s in flown.received(m.FcStatus) if s.state == State.TRACKING)
    reached = [e for e in flown.received(m.FcEstimate) if abs(e.tick - status.reference_tick - 2_000) < 10]
    assert reached[0].p[0] == pytest.approx(1.5, abs=0.03)  # half-way there the reference is at its far end


def test_heartbeat_shows_arming(flown):
    armed = [bool(h.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) for h in flown.received(m.Heartbeat)]
    assert not armed[0]
    assert any(armed)
    assert all(m.dialect_version(h) == m.DIALECT_VERSION for h in flown.received(m.Heartbeat))


def test_messages_of_each_component_arrive_in_order(flown):
    """The fast streams and the other private messages have components of their own."""
    senders = {}
    for message in flown.inbox:
        if message.get_srcSystem() == 1:
            senders.setdefault(m.sender_of(message), []).append(message)
    kinds = {sender: {type(message) for message in senders[sender]} for sender in senders}
    assert kinds[m.VEHICLE_FAST] == {m.FcControl, m.FcEstimate}
    assert m.FcStatus in kinds[m.VEHICLE_PRIVATE]
    assert all(kind.id >= m.PRIVATE_ID_MIN for kind in kinds[m.VEHICLE_PRIVATE])
    assert all(kind.id < m.PRIVATE_ID_MIN for kind in kinds[m.VEHICLE])
    for sent in senders.values():
        steps = {(b.get_seq() - a.get_seq()) & 0xFF for a, b in itertools.pairwise(sent)}
        assert steps == {1}


def test_commands_are_acknowledged_to_who_asked(flown):
    acks = flown.received(m.CommandAck)
    assert [(a.command, a.result) for a in acks] == [(400, 0), (300, 0)]
    assert all((a.target_system, a.target_component) == HOST for a in acks)


def test_flight_over_air_that_loses_a_fifth_still_ends_well(make_session, make_blob):
    session = make_session()
    chance = random.Random(5)
    session.lost = lambda now_us: chance.random() < 0.2
    session.run(0.5)
    assert session.put(make_blob()).state.name == "DONE"
    session.run(0.5)
    for number, parameters, state in ((400, (1.0,), State.ARMED), (300, (), State.TAKEOFF)):
        for _ in range(10):
            session.command(number, *parameters)
            session.run(0.1)
            if session.flight.state is state:
                break
    session.run_to(State.STANDBY)
    assert session.flight.flight.failsafe == 0
    assert session.host.lost > 100


def test_arm_and_start_refused_say_why(make_session):
    session = make_session()
    session.mocap = False
    session.run(1.0)
    session.command(400, 1.0)
    session.run(0.2)
    ack = session.received(m.CommandAck)[-1]
    assert ack.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert "arm refused: no mocap" in session.texts()
    session.mocap = True
    session.run(0.2)
    session.command(400, 1.0)
    session.run_to(State.ARMED, 1.0)
    session.command(300)
    session.run(0.2)
    ack = session.received(m.CommandAck)[-1]
    assert (ack.command, ack.result) == (300, mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
    assert "start refused: no live reference: upload one" in session.texts()
    assert session.flight.state is State.ARMED


def test_command_unknown_is_unsupported(make_session):
    session = make_session()
    session.command(9999)
    session.command(512, 9999.0)
    session.run(0.2)
    assert [a.result for a in session.received(m.CommandAck)] == [mavlink.MAV_RESULT_UNSUPPORTED] * 2


def test_command_for_another_system_is_left_alone(make_session):
    session = make_session()
    session.send(m.CommandLong(2, 1, 512, 0, 148.0, 0, 0, 0, 0, 0, 0))
    session.run(0.2)
    assert session.received(m.CommandAck) == []


def test_version_carries_uid_vehicle_and_dialect(make_session):
    uid = 0x0123456789ABCDEF_FEDCBA9876543210_55AA
    session = make_session(uid=uid, board_version=m.SIMULATED_BOARD)
    session.command(512, 148.0)
    session.run(0.2)
    (version,) = session.received(m.AutopilotVersion)
    assert int.from_bytes(bytes(version.uid2), "little") == uid
    assert bytes(version.flight_custom_version)[:6].hex() == VEHICLE_ID
    assert (version.vendor_id, version.product_id) == (m.VENDOR_ID, m.DIALECT_VERSION)
    assert version.board_version == m.SIMULATED_BOARD
    assert ".".join(map(str, version.flight_sw_version.to_bytes(4, "big")[:3])) == package_version("trimtab")


def test_timesync_and_ping_are_answered(make_session):
    session = make_session()
    session.talk = session.mocap = False
    session.run(0.3)
    session.send(m.Timesync(0, 42), m.Ping(7, 3, 0, 0))
    asked = session.now_us
    session.run(0.1)
    (sync,) = session.received(m.Timesync)
    assert sync.ts1 == 42
    assert asked < sync.tc1 / 1000 < session.now_us
    (ping,) = session.received(m.Ping)
    assert (ping.time_usec, ping.seq, ping.target_system, ping.target_component) == (7, 3, *HOST)


# Parameters.


def test_param_list_sends_every_parameter_once(make_session):
    session = make_session()
    session.send(m.ParamRequestList(1, 1))
    session.run(1.5)
    values = {v.param_id: decode(v.param_value, v.param_type) for v in session.received(m.ParamValue)}
    assert values == {p.name: float32(p.default) for p in PARAMETERS}
    assert {v.param_count for v in session.received(m.ParamValue)} == {len(PARAMETERS)}


def test_param_whole_numbers_travel_as_bits_both_ways(make_session):
    session = make_session()
    session.run(0.3)
    session.send(m.ParamSet(1, 1, b"BAT_CELLS", encode(6.0, INT32), INT32))
    session.run(0.2)
    answer = session.received(m.ParamValue)[-1]
    assert answer.param_type == INT32
    assert struct.pack("<f", answer.param_value) == struct.pack("<i", 6)
    assert session.flight.parameters["BAT_CELLS"] == 6.0
    session.send(m.ParamSet(1, 1, b"BAT_CELLS", 5.0, REAL32))  # as MAVProxy does
    session.run(0.2)
    assert session.flight.parameters["BAT_CELLS"] == 5.0


@pytest.mark.parametrize(
    ("name", "raw", "kind", "text"),
    [
        (b"BAT_CELLS", 3.0, 1, "BAT_CELLS kept: set it as INT32"),
        (b"BAT_CELLS", 3.5, REAL32, "BAT_CELLS: 3.5 is not a whole number"),
        (b"MASS", encode(1.0, INT32), INT32, "MASS kept: set it as REAL32"),
        (b"MASS", 1.0, 1, "MASS kept: set it as REAL32"),
        (b"BAT_CELLS", encode(99.0, INT32), INT32, "BAT_CELLS: 99 is outside 1..24"),
        (b"MASS", math.inf, REAL32, "MASS: inf is not a finite number"),
    ],
)
def test_param_set_of_another_type_or_out_of_range_is_refused(make_session, name, raw, kind, text):
    session = make_session()
    session.run(0.3)
    session.send(m.ParamSet(1, 1, name, raw, kind))
    session.run(0.2)
    (answer,) = session.received(m.ParamValue)
    assert decode(answer.param_value, answer.param_type) == float32(DEFAULTS[name.decode()])
    assert text in session.texts()
    (error,) = session.received(m.ParamError)
    assert (error.param_id, error.error) == (name.decode(), mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)
    assert (error.target_system, error.target_component) == HOST
    assert session.inbox.index(error) < session.inbox.index(answer)


def test_parameter_that_does_not_exist_is_answered_with_an_error(make_session):
    session = make_session()
    session.run(0.3)
    session.send(m.ParamSet(1, 1, b"NOPE", 1.0, REAL32), m.ParamRequestRead(1, 1, b"NOPE2", -1))
    session.send(m.ParamRequestRead(1, 1, b"", 9999))
    session.run(0.2)
    errors = [(error.param_id, error.param_index, error.error) for error in session.received(m.ParamError)]
    missing = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert errors == [("NOPE", -1, missing), ("NOPE2", -1, missing), ("", 9999, missing)]


def test_parameter_set_while_armed_is_answered_with_an_error(make_session):
    session = make_session()
    session.run(1.0)
    session.command(400, 1.0)
    session.run_to(State.ARMED, 1.0)
    session.send(m.ParamSet(1, 1, b"HOLD_S", 2.0, REAL32))
    session.run(0.2)
    (error,) = session.received(m.ParamError)
    assert error.error == mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED


def test_param_lists_asked_for_by_two_stations_both_come_whole(make_session):
    session = make_session()
    session.send(m.ParamRequestList(1, 1))
    session.run(0.3)
    heard = len(session.received(m.ParamValue))
    assert 10 < heard < len(PARAMETERS) - 10
    session.send(m.ParamRequestList(1, 1))
    session.run(1.5)
    everyone = [v.param_index for v in session.received(m.ParamValue)]
    assert set(everyone) == set(range(len(PARAMETERS)))
    assert set(everyone[heard + 5 :]) == set(range(len(PARAMETERS)))  # from the second request on
    assert len(everyone) < 2 * len(PARAMETERS)


def test_param_read_by_name_and_by_index(make_session):
    session = make_session(parameters={"HOVER_S": 2.5})
    session.send(m.ParamRequestRead(1, 1, b"HOVER_S", -1), m.ParamRequestRead(1, 1, b"", 0))
    session.send(m.ParamRequestRead(1, 1, b"NO_SUCH", -1), m.ParamRequestRead(1, 1, b"", 9_999))
    session.run(0.2)
    first, second = session.received(m.ParamValue)
    assert (first.param_id, first.param_value) == ("HOVER_S", 2.5)
    assert second.param_id == PARAMETERS[0].name


def test_param_set_reaches_the_law_and_is_answered(make_session):
    session = make_session()
    session.run(0.3)
    session.send(m.ParamSet(1, 1, b"POS_P_N", 4.25, 9))
    session.run(0.2)
    assert session.received(m.ParamValue)[-1].param_value == 4.25
    assert 4.25 in list(session.engine.inputs["parameters"])


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        (b"POS_P_N", 1e9, "outside"),
        (b"POS_P_N", math.nan, "not a finite number"),
        (b"NO_SUCH", 1.0, "no parameter NO_SUCH"),
        (b"TORQUE_PER_N", 0.0, "outside"),
    ],
)
def test_param_set_refused_keeps_the_value_and_says_why(make_session, name, value, text):
    session = make_session()
    session.run(0.3)
    session.send(m.ParamSet(1, 1, name, value, 9))
    session.run(0.2)
    assert any(text in line for line in session.texts())
    for answer in session.received(m.ParamValue):
        assert answer.param_value == float32(DEFAULTS[name.decode()])


def test_param_set_that_makes_the_rotors_useless_is_refused(make_session):
    session = make_session(parameters={f"ROTOR{k}_X": 0.0 for k in (1, 2, 3)})
    session.run(0.3)
    session.send(m.ParamSet(1, 1, b"ROTOR4_X", 0.0, 9))  # all rotors in a line: no pitch torque
    session.run(0.2)
    assert session.received(m.ParamValue)[-1].param_value == float32(DEFAULTS["ROTOR4_X"])
    assert session.flight.parameters["ROTOR4_X"] == float32(DEFAULTS["ROTOR4_X"])
    assert any(text.startswith("ROTOR4_X: singular") for text in session.texts())


def test_param_set_that_contradicts_another_is_refused_and_the_next_check_works(make_session, make_blob):
    session = make_session()
    session.run(0.3)
    session.send(m.ParamSet(1, 1, b"FENCE_N_MIN", 20.0, 9))  # north of FENCE_N_MAX
    session.run(0.2)
    assert session.received(m.ParamValue)[-1].param_value == DEFAULTS["FENCE_N_MIN"]
    assert "FENCE_N_MIN: geofence 20 to 10 is not an interval" in session.texts()
    assert session.put(make_blob()).state.name == "DONE"


def test_param_set_of_a_limit_renews_the_verdict_on_the_live_reference(make_session, make_blob):
    session = make_session()
    session.run(0.5)
    session.put(make_blob())
    session.run(0.5)
    session.send(m.ParamSet(1, 1, b"LIM_SPEED", 0.5, 9))
    session.run(0.1)
    refused = next(
        k for k, text in enumerate(session.texts()) if text.startswith("live blob refused at node")
    )
    assert session.texts()[refused + 1].endswith(" above 0.5 m/s")
    session.command(400, 1.0)
    session.command(300)
    session.run(0.1)
    assert "start refused: no live reference: upload one" in session.texts()
    session.command(400, 0.0)
    session.run(0.1)
    session.send(m.ParamSet(1, 1, b"LIM_SPEED", 5.0, 9))
    session.run(0.1)
    session.command(400, 1.0)
    session.run_to(State.ARMED, 1.0)


def test_param_set_in_flight_is_refused(make_session, make_blob):
    session = make_session()
    session.run(0.5)
    session.put(make_blob())
    session.take_off()
    session.send(m.ParamSet(1, 1, b"POS_P_N", 4.25, 9))
    session.run(0.2)
    assert session.received(m.ParamValue)[-1].param_value == DEFAULTS["POS_P_N"]
    assert "POS_P_N kept: set in standby only" in session.texts()


# Uploads.


def test_upload_too_fast_is_refused_with_node_and_reason_and_nothing_goes_live(make_session, make_blob):
    session = make_session()
    session.run(0.3)
    sender = session.put(make_blob(reach=3.0, seconds=0.7, pieces=14))
    assert sender.state.name == "FAILED"
    assert sender.verdict is not None
    assert not sender.verdict.ok
    assert sender.verdict.node is not None
    assert 0 < sender.verdict.reason < 100
    unit = sender.verdict.message.rpartition(" ")[2]
    assert unit in ("m/s", "deg", "rad/s", "m/s^3", "max")  # the sentence is whole
    assert sender.reason == f"refused on board at node {sender.verdict.node}: {sender.verdict.message}"
    assert session.store.live(Kind.REFERENCE) is None
    assert session.store.staged(Kind.REFERENCE) is None


def test_reference_with_moving_ends_is_taken_but_never_started(make_session):
    """From rest on the floor there is no way into it."""
    session = make_session()
    session.run(0.5)
    nodes = tuple(Node(round(1e6 * t), (3.0 * t, 0.0, -1.0, 3.0, *(0.0,) * 8)) for t in (0.0, 0.5, 1.0))
    moving = Reference(vehicle_id=VEHICLE_ID, origin_ned=(0.0, 0.0, 0.0), nodes=nodes, free_ends=True)
    assert session.put(moving).state.name == "DONE"
    session.run(0.5)
    session.command(400, 1.0)
    session.command(300)
    session.run(0.2)
    assert "start refused: reference not at rest at its ends" in session.texts()
    assert session.flight.state is State.ARMED


def test_upload_is_not_disturbed_by_the_chunks_of_another_station(make_session, make_blob):
    session = make_session()
    session.run(0.3)
    blob, other = make_blob(), make_blob(reach=1.0).to_bytes()
    stray = UploadSender(other, Kind.REFERENCE)
    session.upload = UploadSender(blob.to_bytes(), blob.KIND)
    for index in range(8):
        data = other[99 * index : 99 * index + 99].ljust(99, b"\0")
        tag = stray.digest[0] | stray.digest[1] << 8
        session.send(m.UploadChunk(tag, index, 1, data))
        session.run(0.01)
    session.run(5.0, until=lambda: session.upload.state.name == "DONE")
    assert session.store.live(Kind.REFERENCE) == blob.to_bytes()
    assert session.upload.chunks_repeated == 0


def test_upload_for_another_vehicle_is_refused(make_session, make_blob):
    session = make_session()
    sender = session.put(make_blob(vehicle_id="ba9876543210"))
    assert sender.verdict is not None
    assert sender.verdict.reason == Reason.OTHER_VEHICLE


def test_upload_refused_leaves_the_live_reference_in_place(make_session, make_blob):
    session = make_session()
    session.put(make_blob())
    session.put(make_blob(reach=3.0, seconds=0.7, pieces=14))
    session.run(0.2)
    assert session.store.live(Kind.REFERENCE) == make_blob().to_bytes()
    assert bytes(session.received(m.FcStatus)[-1].reference_id).hex() == make_blob().id


def test_commit_in_flight_is_busy_and_the_flight_goes_on(make_session, make_blob):
    session = make_session()
    session.run(0.5)
    session.put(make_blob())
    session.take_off()
    sender = session.put(make_blob(reach=1.0), seconds=6.0)
    assert sender.state.name == "FAILED"
    statuses = session.received(m.UploadStatus)
    assert any(s.result == UploadResult.BUSY for s in statuses)
    assert session.store.live(Kind.REFERENCE) == make_blob().to_bytes()
    session.run_to(State.STANDBY)
    assert session.flight.flight.failsafe == 0


def test_commit_by_command_takes_the_staged_blob(make_session, make_blob):
    session = make_session()
    blob = make_blob()
    session.upload = UploadSender(blob.to_bytes(), blob.KIND, commit=False)
    session.run(2.0, until=lambda: session.store.staged(Kind.REFERENCE) is not None)
    session.upload = None
    numbers = [float(int(blob.id[k : k + 4], 16)) for k in (0, 4, 8)]
    session.command(31010, 1.0, 2.0, 3.0)
    session.command(31010, math.nan)
    session.command(31010, *numbers)
    session.run(0.2)
    results = [a.result for a in session.received(m.CommandAck)]
    assert results == [mavlink.MAV_RESULT_FAILED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_ACCEPTED]
    assert session.store.live(Kind.REFERENCE) == blob.to_bytes()
    assert session.flight.flight.reference is not None


def test_power_cycle_keeps_the_live_reference(make_session, make_blob):
    session = make_session()
    session.put(make_blob())
    again = make_session(store=session.store)
    again.take_off()
    again.run_to(State.TRACKING)


def test_power_cycle_with_stricter_limits_refuses_what_is_live(make_session, make_blob):
    session = make_session()
    session.put(make_blob())
    again = make_session(store=session.store, parameters={"LIM_SPEED": 0.5})
    again.run(1.0)
    again.command(400, 1.0)
    again.command(300)
    again.run(0.2)
    assert any(text.startswith("live blob refused") for text in again.texts())
    assert "start refused: no live reference: upload one" in again.texts()


def test_feedforward_reaches_the_law_and_an_absurd_one_does_not(make_session):
    session = make_session()
    model_id = "00112233aabb"
    block = (1.05, *(0.0,) * 3, 0.4, 0.4, 0.0, *(0.0,) * 3, 0.0, 0.0, 0.004, 1.0, -2.0, 0.0, 1.5)
    session.put(FeedForward(vehicle_id=VEHICLE_ID, model_id=model_id, block=block))
    assert list(session.engine.inputs["feedforward"]) == [*(float32(x) for x in block), *OPEN_REGION]
    absurd = FeedForward(vehicle_id=VEHICLE_ID, model_id=model_id, block=(9.0, *block[1:]))
    sender = session.put(absurd)
    assert sender.verdict is not None
    assert sender.verdict.reason == Reason.FEEDFORWARD_RANGE
    assert session.engine.inputs["feedforward"][0] == float32(1.05)


# Damage.


def test_receive_buffer_overrun_is_counted_and_the_link_recovers(make_session):
    session = make_session()
    session.run(0.3)
    flight, now = session.flight, session.now_us
    codec = Codec(*HOST)
    burst = b"".join(codec.encode(m.Ping(0, k, 0, 0)) for k in range(400))
    assert session.radio.uart.write(burst[:8_000], now)
    session.now_us += 100_000  # the processor hangs while they arrive
    for radio in (session.ground, session.radio):
        radio.tick(session.now_us)
    session.run(0.5)
    lost = 8_000 - 2_048
    assert flight.uart.overruns >= lost
    status = session.received(m.FcStatus)[-1]
    assert status.uart_overruns >= lost
    assert status.loop_overruns == 1
    before = len(session.received(m.AutopilotVersion))
    session.command(512, 148.0)
    session.run(0.2)
    assert len(session.received(m.AutopilotVersion)) == before + 1


def test_messages_of_another_dialect_version_are_told_apart_from_silence(make_session):
    session = make_session()
    frame = bytearray(session.host.encode(m.UploadBegin(10, 1, 1, 99, 1, bytes(32))))
    frame[-2:] = struct.pack("<H", (int.from_bytes(frame[-2:], "little") + 1) & 0xFFFF)
    for _ in range(5):
        session.radio.uart.write(bytes(frame), session.now_us)
        session.run(0.1)
    session.run(5.0)
    assert any("unknown messages" in text for text in session.texts())
    assert session.flight.state is State.STANDBY


def test_nan_from_the_sensors_never_raises_and_ends_in_motors_off(make_session, make_blob):
    session = make_session()
    session.run(0.5)
    session.put(make_blob())
    session.take_off()
    session.run(1.0)
    for _ in range(3_000):
        session.flight.tick(session.now_us, (math.nan,) * 3, (math.nan,) * 3, math.nan)
        session.now_us += 1_000
    assert session.flight.outbox.unsendable > 0
    assert session.flight.state is State.STANDBY
    assert max(session.flight.motor_command) == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_random_bytes_never_raise(make_session, seed):
    session = make_session()
    chance = random.Random(seed)
    codec = Codec(*HOST)
    kinds = list(mavlink.mavlink_map.values())
    for _ in range(400):
        data = chance.randbytes(chance.randrange(1, 120))
        if chance.random() < 0.5:  # whole messages with random payloads
            kind = chance.choice(kinds)
            payload = chance.randbytes(kind.unpacker.size)
            body = struct.pack(
                "<BBBBBBB", len(payload), 0, 0, chance.randrange(256), 255, 190, kind.id & 0xFF
            )
            body += struct.pack("<H", kind.id >> 8) + payload
            crc = mavlink.x25crc(body)
            crc.accumulate(bytes([kind.crc_extra]))
            data = b"\xfd" + body + struct.pack("<H", crc.crc)
        session.radio.uart.write(data, session.now_us)
        session.port.write(chance.randbytes(chance.randrange(40)), session.now_us)
        session.radio.air_receive(chance.randbytes(chance.randrange(130)), session.now_us)
        for _ in range(3):
            session.tick()
    assert codec.decode(b"") == []
    assert session.flight.state in State
