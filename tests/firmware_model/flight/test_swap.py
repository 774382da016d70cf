"""A reference that takes over in flight: at the agreed tick, where it continues the one flown, or never."""

import math
import random
from dataclasses import replace

import pytest

from trimtab.firmware_model.flight.supervisor import State
from trimtab.firmware_model.flight.swap import agree_swap
from trimtab.firmware_model.flight.track import track
from trimtab.firmware_model.law.limits import from_parameters
from trimtab.firmware_model.law.reference import septic
from trimtab.firmware_model.law.smoothness import JUMPS
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Node
from trimtab.protocol.messages import NO_TICK, UploadResult, UploadState
from trimtab.protocol.parameters import DEFAULTS
from trimtab.protocol.upload import UploadSender

LIMITS = from_parameters(DEFAULTS)[1]
REST9 = (0.0,) * 9
AT_US = 2_700_000
"""In the second leg of the reference flown: the vehicle moves and turns around."""


@pytest.fixture
def flown_blob(make_blob):
    return make_blob(pieces=20)


def following(blob, at_us=AT_US, end=(0.6, 0.8, -1.4), seconds=2.5, **changes):
    """A blob that goes on from `blob` at a time of its, to rest at `end`; changes: of its first node."""
    state = list(track(blob.nodes, blob.yaw_nodes()).state_at(at_us)[:12])
    for name, value in changes.items():
        state[3 * "pvaj".index(name[0]) + int(name[1])] += value
    nodes = []
    steps = round(seconds / 0.1)
    for k in range(steps + 1):
        p, v, a, j, _ = septic(seconds, seconds * k / steps, state, (*end, *REST9))
        nodes.append(Node(round(1e6 * seconds) * k // steps, (*p, *v, *a, *j)))
    return replace(blob, nodes=tuple(nodes), free_ends=True)


def agree(blob, after, at_us=AT_US, ahead_us=500_000):
    tracks = [track(b.nodes_ned(), b.yaw_nodes()) for b in (blob, after)]
    return agree_swap(tracks[0], after, tracks[1], at_us=at_us, ahead_us=ahead_us, limits=LIMITS)


# The judgement.


def test_reference_that_continues_is_agreed_to(flown_blob):
    assert agree(flown_blob, following(flown_blob)).result is UploadResult.OK


@pytest.mark.parametrize("quantity", range(4))
def test_jump_beyond_its_bound_is_refused_with_value_and_bound(flown_blob, quantity):
    name, bound, unit = JUMPS[quantity]
    letter = "pvaj"[quantity]
    assert agree(flown_blob, following(flown_blob, **{f"{letter}1": 0.9 * bound})).result is UploadResult.OK
    found = agree(flown_blob, following(flown_blob, **{f"{letter}1": -1.2 * bound}))
    assert found.result is UploadResult.NOT_CONTINUOUS
    assert found.verdict is not None
    assert (found.verdict.node, found.verdict.reason) == (0, 104)
    assert (found.verdict.value, found.verdict.bound) == (pytest.approx(1.2 * bound, rel=0.01), bound)
    assert found.verdict.message.startswith(f"{name} jumps by ")
    assert found.verdict.message.endswith(f"above {bound:.3g} {unit}")


@pytest.mark.parametrize(("yaw", "rate", "ok"), [(0.2, 0.0, True), (0.2 + 2 * math.pi, 0.0, True),
                                                 (0.21, 0.0, False), (0.2, 0.02, False)])  # fmt: skip
def test_heading_must_continue_too_but_whole_turns_are_none(flown_blob, yaw, rate, ok):
    after = following(flown_blob)
    yaws = ((0, yaw, rate), (2_000_000, yaw, 0.0))
    assert (agree(flown_blob, replace(after, yaws=yaws)).result is UploadResult.OK) is ok


def test_tick_that_is_too_near_or_past_the_end_is_too_late(flown_blob):
    after = following(flown_blob)
    assert agree(flown_blob, after, ahead_us=100_000).result is UploadResult.OK
    found = agree(flown_blob, after, ahead_us=99_000)
    assert found.verdict is not None
    assert (found.result, found.verdict.reason) == (UploadResult.TOO_LATE, 105)
    assert (found.verdict.value, found.verdict.bound) == (pytest.approx(0.099), pytest.approx(0.1))
    assert agree(flown_blob, after, at_us=4_000_000).result is UploadResult.TOO_LATE


def test_reference_that_ends_moving_or_low_is_refused(flown_blob):
    low = agree(flown_blob, following(flown_blob, end=(0.6, 0.8, -0.4)))
    assert low.verdict is not None
    assert (low.result, low.verdict.reason) == (UploadResult.NOT_CONTINUOUS, 5)
    after = following(flown_blob)
    cut = agree(flown_blob, replace(after, nodes=after.nodes[:12]))
    assert cut.verdict is not None
    assert cut.verdict.reason == 4


# In flight, over the radio.


def fly(session, blob):
    """The session, tracking `blob`."""
    session.run(0.5)
    assert session.put(blob).state.name == "DONE"
    session.take_off()
    session.run_to(State.TRACKING)
    return session.flight.flight.tracking_us


def put_at(session, blob, at_tick, seconds=3.0):
    """The sender of `blob` to take over at a tick, once it is over."""
    session.upload = UploadSender(blob.to_bytes(), blob.KIND, at_tick=at_tick, interval_us=10_000)
    session.run(seconds, until=lambda: session.upload.over)
    upload, session.upload = session.upload, None
    return upload


def test_swap_happens_at_the_agreed_tick_and_is_told(make_session, flown_blob):
    session = make_session()
    start_us = fly(session, flown_blob)
    after = following(flown_blob)
    at_us = start_us + AT_US
    upload = put_at(session, after, at_us // 1000)
    assert upload.state.name == "DONE", upload.reason
    assert session.now_us < at_us
    assert session.store.live(1) == flown_blob.to_bytes()
    session.run(0.1)
    status = session.received(m.FcStatus)[-1]
    assert (status.swap_tick, bytes(status.staged_id).hex()) == (at_us // 1000, after.id)
    while session.now_us < at_us:
        session.tick()
    assert session.flight.flight.tracking_us == start_us
    before = tuple(session.flight.flight.outputs["reference"])
    session.tick()  # the agreed one
    assert session.flight.flight.tracking_us == at_us
    assert session.store.live(1) == after.to_bytes()
    now = tuple(session.flight.flight.outputs["reference"])
    assert math.dist(now[:3], before[:3]) < 2e-3  # a tick of flight
    assert now[0] == pytest.approx(after.nodes_ned()[0].state[0], abs=1e-9)
    session.run(0.2)
    status = session.received(m.FcStatus)[-1]
    assert (bytes(status.reference_id).hex(), status.swap_tick) == (after.id, NO_TICK)
    assert status.reference_tick == at_us // 1000
    assert "reference swapped" in session.texts()
    session.run_to(State.HOLD)
    assert math.dist(session.body.p, (0.6, 0.8, -1.4)) < 0.05
    session.run_to(State.STANDBY)
    session.run(0.3)
    session.command(400, 1.0)
    session.run(0.3)
    session.command(300)
    session.run(0.3)
    assert any("not at rest" in text for text in session.texts())  # it began in flight


def test_swap_and_status_count_on_where_ticks_begin_anew(make_session, flown_blob):
    """After 49.7 days: the flight is tracked before, the swap comes behind."""
    session, wrap_us = make_session(), 2**32 * 1000
    session.now_us = wrap_us - 7_000_000
    start_us = fly(session, flown_blob)
    assert start_us < wrap_us < start_us + AT_US
    at_us = start_us + AT_US
    after = following(flown_blob)
    upload = put_at(session, after, at_us // 1000 & 0xFFFF_FFFF)
    assert upload.state.name == "DONE", upload.reason
    session.run_to(State.HOLD)
    assert session.flight.flight.tracking_us == at_us
    session.run(0.2)
    status = session.received(m.FcStatus)[-1]
    assert (status.reference_tick, status.state) == ((at_us - wrap_us) // 1000, State.HOLD)
    assert session.flight.outbox.unsendable == 0


def staged(session, blob):
    """The session, with `blob` on board and not committed."""
    files = session.flight._services._ftp._files
    assert files.write("/ref/staged.ref", blob.to_bytes(), session.now_us)
    return files, files.find("/ref/staged.ref")


def test_parameters_that_change_refuse_what_was_staged_before(make_session, flown_blob):
    session = make_session()
    session.run(0.5)
    assert session.put(flown_blob).state.name == "DONE"
    after = following(flown_blob)  # ends 0.8 m to the east
    files, file = staged(session, after)
    session.send(m.ParamSet(1, 1, b"FENCE_E_MAX", 0.9, 9))
    session.run(0.3)
    assert files.read(file) == after.to_bytes()
    session.send(m.ParamSet(1, 1, b"FENCE_E_MAX", 0.5, 9))
    session.run(0.3)
    assert bytes(session.received(m.FcStatus)[-1].staged_id) == bytes(6)
    assert files.read(file) is None
    assert not any(entry.name == "staged.ref" for entry in files.entries("/ref"))
    session.take_off()
    session.run_to(State.TRACKING)
    at_us = session.flight.flight.tracking_us + AT_US
    assert put_at(session, after, at_us // 1000).state.name == "FAILED"
    session.run_to(State.HOLD)
    assert max(session.body.p[1], 0.0) < 0.1
    assert session.store.live(1) == flown_blob.to_bytes()


def test_what_is_agreed_is_kept_where_it_or_another_is_written_as_a_file(make_session, flown_blob):
    session = make_session()
    start_us = fly(session, flown_blob)
    after = following(flown_blob)
    at_tick = (start_us + AT_US) // 1000
    assert put_at(session, after, at_tick).state.name == "DONE"
    files, file = staged(session, after)
    assert not files.write("/ref/staged.ref", flown_blob.to_bytes()[:-1] + b"x", session.now_us)
    session.run(0.1)
    assert session.received(m.FcStatus)[-1].swap_tick == at_tick
    assert files.remove(file, session.now_us)
    session.run(0.1)
    assert session.received(m.FcStatus)[-1].swap_tick == NO_TICK
    session.run_to(State.HOLD)
    assert session.store.live(1) == flown_blob.to_bytes()


@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_swap_is_agreed_over_a_radio_that_loses_frames(make_session, make_blob, loss):
    chance = random.Random(8401)
    blob = make_blob(pieces=20, seconds=4.0)
    session = make_session()
    start_us = fly(session, blob)
    session.lost = lambda now_us: chance.random() < loss
    after = following(blob, at_us=6_000_000)
    upload = put_at(session, after, (start_us + 6_000_000) // 1000, seconds=5.5)
    assert upload.state.name == "DONE", upload.reason
    session.run_to(State.HOLD)
    assert session.flight.flight.tracking_us == start_us + 6_000_000
    assert math.dist(session.body.p, (0.6, 0.8, -1.4)) < 0.08


def test_what_does_not_continue_stays_staged_and_the_flight_goes_on(make_session, flown_blob):
    session = make_session()
    start_us = fly(session, flown_blob)
    upload = put_at(session, following(flown_blob, p1=0.05), (start_us + AT_US) // 1000)
    assert upload.state.name == "FAILED"
    assert upload.reason == "refused on board at node 0: position jumps by 0.05 at the swap, above 0.001 m"
    assert session.received(m.UploadStatus)[-1].result == UploadResult.NOT_CONTINUOUS
    session.run_to(State.HOLD)
    assert session.store.live(1) == flown_blob.to_bytes()
    assert session.flight.flight.tracking_us == start_us


@pytest.mark.parametrize("how", ["land", "failsafe", "abort", "at once", "another tick"])
def test_schedule_is_called_off(make_session, flown_blob, how):
    session = make_session()
    start_us = fly(session, flown_blob)
    after = following(flown_blob)
    upload = put_at(session, after, (start_us + AT_US) // 1000)
    state, result = UploadState.STAGED, UploadResult.OK
    if how == "land":
        session.command(21)
    elif how == "failsafe":
        session.mocap = False
    elif how == "abort":
        session.send(m.UploadAbort(1, upload.digest))
        state = UploadState.IDLE
    elif how == "at once":
        session.send(m.UploadCommit(NO_TICK, 1, 1, upload.digest))
        result = UploadResult.BUSY
    else:
        session.send(m.UploadCommit((start_us + AT_US) // 1000 + 20, 1, 1, upload.digest))
        result = UploadResult.NOT_CONTINUOUS
    told = len(session.inbox)
    while session.now_us < start_us + AT_US + 100_000:
        session.tick()
    answers = [message for message in session.inbox[told:] if isinstance(message, m.UploadStatus)]
    assert (state, result) in [(answer.state, answer.result) for answer in answers]
    assert session.flight.flight.tracking_us == start_us
    assert session.store.live(1) == flown_blob.to_bytes()
    assert session.store.staged(1) == (None if how == "abort" else after.to_bytes())
    assert session.received(m.FcStatus)[-1].swap_tick == NO_TICK


def test_tick_is_refused_on_the_floor(make_session, flown_blob):
    session = make_session()
    session.run(0.5)
    upload = put_at(session, flown_blob, 5_000)
    assert (upload.state.name, upload.reason) == (
        "FAILED",
        "the vehicle is not tracking a reference, so there is nothing to swap",
    )


def test_repeated_commit_of_the_same_tick_changes_nothing_even_when_it_comes_late(make_session, flown_blob):
    session = make_session()
    start_us = fly(session, flown_blob)
    upload = put_at(session, following(flown_blob), (start_us + AT_US) // 1000)
    while session.now_us < start_us + AT_US - 60_000:
        session.tick()
    session.send(m.UploadCommit((start_us + AT_US) // 1000, 1, 1, upload.digest))
    session.run(0.04)
    assert session.received(m.UploadStatus)[-1].state == UploadState.SCHEDULED
    session.run(0.1)
    assert session.flight.flight.tracking_us == start_us + AT_US
    session.send(m.UploadCommit((start_us + AT_US) // 1000, 1, 1, upload.digest))
    session.run(0.1)
    assert session.received(m.UploadStatus)[-1].state == UploadState.LIVE
