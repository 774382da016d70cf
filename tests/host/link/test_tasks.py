"""What the host asks of a vehicle, over a line that loses messages, and what it says when nobody answers."""

from __future__ import annotations

import random
from collections.abc import Callable, Generator
from typing import Any

import pytest

from trimtab.host.base.errors import LinkError, Refused
from trimtab.host.link.parameter_tasks import ReadParameters, SetParameter
from trimtab.host.link.session import Script, Session
from trimtab.host.link.tasks import Command, FindVehicle, FreshStatus, Identity, SettleClock, Task
from trimtab.host.link.upload_tasks import SendBlob, make_live
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Kind, Node, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import UploadState, mavlink
from trimtab.protocol.upload import Verdict

Run = Callable[..., Session]
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


def one(task: Task) -> Callable[[Session], Generator[Task, Any, Any]]:
    """A script of one task."""

    def script(session: Session) -> Generator[Task, Any, Any]:
        return (yield task)

    return script


def failure(session: Session, kind: type[Exception]) -> str:
    """The one line that the session ended with."""
    assert isinstance(session.error, kind), session.error
    text = str(session.error)
    assert "\n" not in text
    return text


def lossy(seed: int, share: float) -> Callable[[], bool]:
    """Whether the next message is lost."""
    generator = random.Random(seed)
    return lambda: generator.random() < share


def test_find_vehicle_tells_who_it_is(run: Run, fake: Any) -> None:
    session = run(one(FindVehicle("port")), fake)
    assert session.result == Identity(vehicle_id="0123456789ab", uid="0000000000000007")


@pytest.mark.parametrize(("board", "simulated"), [(0, None), (m.SIMULATED_BOARD, True), (0x0203_0001, False)])
def test_find_vehicle_tells_whether_the_firmware_is_simulated(
    run: Run, fake: Any, board: int, simulated: bool | None
) -> None:
    fake.board_version = board
    assert run(one(FindVehicle("port")), fake).result.simulated is simulated


def test_find_vehicle_over_a_lossy_line_asks_again(run: Run, fake: Any) -> None:
    fake.drop = lossy(3, 0.6)
    assert run(one(FindVehicle("port")), fake).result.vehicle_id == "0123456789ab"


def test_find_vehicle_at_a_silent_port_gives_up_in_time(run: Run) -> None:
    session = run(one(FindVehicle("ttyX")), None)
    assert failure(session, LinkError).startswith("ttyX: no vehicle, nothing was received in 5 s")
    assert session.now_us <= 5_100_000


def test_find_vehicle_among_other_bytes_says_so(run: Run, fake: Any) -> None:
    fake.run = lambda now_us, data: b"$GPGGA,1234\r\n" if now_us % 100_000 == 0 else b""
    assert "bytes that are not MAVLink" in failure(run(one(FindVehicle("ttyX")), fake), LinkError)


def test_find_vehicle_among_other_systems_names_them(run: Run, fake: Any) -> None:
    beats = Codec(2, 1), Codec(17, 1)
    fake.run = lambda now_us, data: b"".join(
        codec.encode(m.vehicle_heartbeat(1, armed=False)) for codec in beats if now_us % 1_000_000 == 0
    )
    text = failure(run(one(FindVehicle("ttyX")), fake), LinkError)
    assert text.startswith("ttyX: no Trimtab vehicle (MAVLink system 1) in 5 s, only system 2, 17")


@pytest.mark.parametrize(
    ("sender", "said"),
    [
        (m.HOST_RADIO, "the radio answers, but no vehicle was heard in 5 s; is it on?"),
        (m.VEHICLE, "a vehicle sends messages, but no heartbeat arrived in 5 s; check the link"),
    ],
    ids=["radio", "vehicle"],
)
def test_find_vehicle_does_not_blame_damaged_bytes_where_something_is_heard(
    run: Run, fake: Any, sender: tuple[int, int], said: str
) -> None:
    codec = Codec(*sender)
    fake.run = lambda now_us, data: (
        b"" if now_us % 1_000_000 else codec.encode(m.RadioStats(*[0] * len(m.RadioStats.fieldnames))) + b"?!"
    )
    assert failure(run(one(FindVehicle("ttyX")), fake), LinkError) == f"ttyX: {said}"


def test_find_vehicle_that_beats_but_does_not_answer_says_so(run: Run, fake: Any) -> None:
    fake.answers = False
    assert "does not answer; check" in failure(run(one(FindVehicle("ttyX")), fake), LinkError)


def test_find_vehicle_of_another_dialect_version_says_both(run: Run, fake: Any) -> None:
    beat = m.vehicle_heartbeat(1, armed=False)
    fake.heartbeat = m.Heartbeat(
        beat.type, beat.autopilot, beat.base_mode, beat.custom_mode + (1 << 4), beat.system_status, 3
    )
    text = failure(run(one(FindVehicle("ttyX")), fake), LinkError)
    assert f"version {m.DIALECT_VERSION + 1}" in text
    assert f"version {m.DIALECT_VERSION};" in text


def test_find_vehicle_whose_version_message_disagrees_is_refused(run: Run, fake: Any) -> None:
    fake.product_id = m.DIALECT_VERSION + 5
    failure(run(one(FindVehicle("ttyX")), fake), LinkError)


def test_find_vehicle_of_another_make_says_so(run: Run, fake: Any) -> None:
    fake.heartbeat = m.Heartbeat(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC, 0, 0, mavlink.MAV_STATE_STANDBY, 3
    )
    assert "does not speak Trimtab" in failure(run(one(FindVehicle("ttyX")), fake), LinkError)


def test_read_parameters_gives_all_of_them(run: Run, fake: Any) -> None:
    values = run(one(ReadParameters()), fake).result
    assert values == {"MASS": pytest.approx(0.752), "POS_P_N": 6.0, "LAND_SPEED": 0.5}


@pytest.mark.parametrize("seed", range(8))
def test_read_parameters_over_a_lossy_line_fills_the_gaps(run: Run, fake: Any, seed: int) -> None:
    fake.parameters = {f"P{k}": float(k) for k in range(60)}
    fake.drop = lossy(seed, 0.3)
    assert run(one(ReadParameters()), fake).result == fake.parameters


def test_read_parameters_that_never_come_is_a_link_error(run: Run, fake: Any) -> None:
    fake.answers = False
    assert "none did" in failure(run(one(ReadParameters()), fake), LinkError)


def test_set_parameter_over_a_lossy_line_sets_it(run: Run, fake: Any) -> None:
    fake.drop = lossy(5, 0.5)
    assert run(one(SetParameter("LAND_SPEED", 0.7)), fake).result == pytest.approx(0.7)
    assert fake.parameters["LAND_SPEED"] == pytest.approx(0.7)


def test_set_parameter_that_stays_is_refused(run: Run, fake: Any) -> None:
    text = failure(run(one(SetParameter("LAND_SPEED", 1000.0)), fake), Refused)
    assert "LAND_SPEED stays 0.5" in text


def test_set_parameter_that_stays_close_by_is_refused(run: Run, fake: Any) -> None:
    fake.parameters["LAND_SPEED"] = 100.0
    failure(run(one(SetParameter("LAND_SPEED", 100.00005)), fake), Refused)


def test_set_parameter_is_what_the_wire_can_hold(run: Run, fake: Any) -> None:
    assert run(one(SetParameter("LAND_SPEED", 0.1)), fake).result == pytest.approx(0.1)


def test_set_parameter_to_no_number_is_a_callers_mistake() -> None:
    with pytest.raises(ValueError, match="nan is not a finite number"):
        SetParameter("LAND_SPEED", float("nan"))


def test_set_parameter_answered_by_no_number_is_refused(run: Run, fake: Any) -> None:
    fake.parameters["LAND_SPEED"] = float("nan")
    assert "stays nan" in failure(run(one(SetParameter("LAND_SPEED", 100.0)), fake), Refused)


def test_set_parameter_name_too_long_is_a_callers_mistake() -> None:
    with pytest.raises(ValueError, match="16"):
        SetParameter("A" * 17, 1.0)


@pytest.mark.parametrize("seed", range(8))
def test_command_over_a_lossy_line_is_repeated_and_numbered(run: Run, fake: Any, seed: int) -> None:
    fake.drop = lossy(seed, 0.5)
    assert run(one(Command(ARM, (1.0,), what="arm")), fake).error is None
    sent = [message for message in fake.heard if isinstance(message, m.CommandLong)]
    assert [message.confirmation for message in sent] == list(range(len(sent)))


def test_command_denied_repeats_the_vehicles_words(run: Run, fake: Any) -> None:
    fake.refuse = lambda number: mavlink.MAV_RESULT_DENIED
    fake.text = "arm refused: no mocap"
    text = failure(run(one(Command(ARM, (1.0,), what="arm", patience_us=9_000_000)), fake), Refused)
    assert text == "the vehicle refuses to arm: no mocap"


def test_command_denied_in_words_that_got_lost_does_not_repeat_older_ones(run: Run, fake: Any) -> None:
    fake.refuse = lambda number: mavlink.MAV_RESULT_DENIED
    fake.send(m.StatusText(4, b"start refused: arm first"))

    def script(session: Session) -> Script:
        yield SettleClock()
        assert session.client.texts
        yield Command(ARM, (1.0,), what="arm")

    text = failure(run(script, fake), Refused)
    assert text == "the vehicle refuses to arm: the reason was lost on the link, result 2"


def test_command_not_now_is_asked_again_until_it_is_accepted(run: Run, fake: Any) -> None:
    answers = iter([mavlink.MAV_RESULT_TEMPORARILY_REJECTED] * 3 + [mavlink.MAV_RESULT_ACCEPTED])
    fake.refuse = lambda number: next(answers)
    assert run(one(Command(ARM, (1.0,), what="arm", patience_us=5_000_000)), fake).error is None


def test_command_not_now_ends_with_its_patience(run: Run, fake: Any) -> None:
    fake.refuse = lambda number: mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    fake.text = "arm refused: tilted"
    session = run(one(Command(ARM, (1.0,), what="arm", patience_us=2_000_000)), fake)
    assert "tilted" in failure(session, Refused)
    assert 2_000_000 <= session.now_us < 3_000_000


def test_command_to_a_silent_vehicle_is_a_link_error(run: Run, fake: Any) -> None:
    fake.answers = False
    assert "does not answer" in failure(run(one(Command(ARM, what="arm")), fake), LinkError)


@pytest.mark.parametrize("seed", range(4))
def test_send_blob_over_a_lossy_line_makes_it_live(run: Run, fake: Any, seed: int) -> None:
    blob = random.Random(seed).randbytes(5000)
    fake.drop = lossy(seed, 0.2)
    session = run(one(SendBlob(blob, Kind.REFERENCE, what="reference")), fake)
    assert session.error is None
    assert fake.store.live(Kind.REFERENCE) == blob


def test_send_blob_refused_on_board_names_node_and_reason(run: Run, fake: Any) -> None:
    fake.verdict = Verdict(ok=False, node=7, reason=2, message="too fast: 12 m/s over 10")
    text = failure(run(one(SendBlob(bytes(500), Kind.REFERENCE, what="reference x")), fake), Refused)
    assert text.startswith("reference x: refused on board at node 7: too fast")
    assert fake.store.live(Kind.REFERENCE) is None


def test_send_blob_to_a_silent_vehicle_is_a_link_error(run: Run, fake: Any) -> None:
    fake.answers = False
    failure(run(one(SendBlob(bytes(500), Kind.REFERENCE, what="reference")), fake), LinkError)


def interrupted(run: Run, fake: Any, then: Callable[[], None]) -> Session:
    """A session that uploads 10 kB and is interrupted after some chunks, when `then` is called too."""
    still = (0.0,) * 12
    nodes = tuple(Node(100_000 * k, still) for k in range(200))
    blob = Reference(vehicle_id="0123456789ab", origin_ned=(0.0, 0.0, -1.0), nodes=nodes)
    sessions: list[Session] = []
    vehicle_run = fake.run

    def script(session: Session) -> Generator[Task, Any, Any]:
        sessions.append(session)
        return (yield from make_live(blob, "reference"))

    def pressing(now_us: int, data: bytes) -> bytes:
        out = vehicle_run(now_us, data)
        if any(isinstance(message, m.UploadChunk) for message in fake.heard):
            assert fake.upload.state is UploadState.RECEIVING
            fake.run = vehicle_run
            then()
            sessions[0].fail(KeyboardInterrupt())
        return out

    fake.run = pressing
    return run(script, fake)


@pytest.mark.parametrize("seed", range(4))
def test_upload_interrupted_makes_the_vehicle_forget(run: Run, fake: Any, seed: int) -> None:
    def then() -> None:
        fake.drop = lossy(seed, 0.3)

    session = interrupted(run, fake, then)
    assert isinstance(session.error, KeyboardInterrupt)
    assert fake.upload.state is UploadState.IDLE
    assert fake.store.live(Kind.REFERENCE) is None


def test_upload_interrupted_at_a_silent_vehicle_ends_soon(run: Run, fake: Any) -> None:
    def then() -> None:
        fake.answers = False

    session = interrupted(run, fake, then)
    assert isinstance(session.error, KeyboardInterrupt)
    assert session.now_us < 3_000_000


def test_settle_clock_finds_the_offset(run: Run, fake: Any) -> None:
    fake.clock_offset_us = -123_456_789
    session = run(one(SettleClock()), fake)
    assert session.client.clock.offset_us == pytest.approx(-123_456_789, abs=500)


def test_settle_clock_without_answers_is_a_link_error(run: Run, fake: Any) -> None:
    fake.answers = False
    failure(run(one(SettleClock()), fake), LinkError)


def test_fresh_status_that_never_comes_is_a_link_error(run: Run, fake: Any) -> None:
    failure(run(one(FreshStatus()), fake), LinkError)
