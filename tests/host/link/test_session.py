"""Bytes of any kind, errors in scripts, poses forwarded on the vehicle's clock."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.host.link.client import Client
from trimtab.host.link.clock import CameraClock
from trimtab.host.link.parameter_tasks import ReadParameters
from trimtab.host.link.session import Session
from trimtab.host.link.tasks import FindVehicle, SettleClock, Task
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec

Run = Callable[..., Session]


class Forever(Task):
    """A task that never ends."""

    def begin(self, client: Client, now_us: int) -> None:
        pass


def pose(stamp_us: int, x: float = 0.0) -> bytes:
    return Codec(*m.CAMERAS).encode(m.AttPosMocap(stamp_us, [1.0, 0.0, 0.0, 0.0], x, 0.0, -1.0))


def test_session_results_of_tasks_come_back_to_the_script(run: Run, fake: Any) -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        identity = yield FindVehicle("port")
        values = yield ReadParameters()
        return identity.vehicle_id, len(values)

    assert run(script, fake).result == ("0123456789ab", 3)


def test_session_error_of_a_task_can_be_handled_in_the_script(run: Run) -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        try:
            yield FindVehicle("port", patience_us=200_000)
        except Exception as error:
            return type(error).__name__

    assert run(script, None).result == "LinkError"


def test_session_failed_from_outside_ends_unless_the_script_goes_on(run: Run) -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        try:
            yield Forever()
        except KeyError:
            yield Forever()

    session = Session(script)
    session.step(0)
    session.fail(KeyError())
    assert not session.done
    session.fail(KeyboardInterrupt())
    assert session.done
    assert isinstance(session.error, KeyboardInterrupt)


class FullDisk:
    """A listener that cannot take anything in."""

    deadline_us = 0

    def receive(self, messages: Any, now_us: int) -> None:
        raise OSError("receive")

    def pose(self, message: Any, vehicle_us: int, now_us: int) -> None:
        raise OSError("pose")

    def link(self, now_us: int) -> None:
        raise OSError("link")


@pytest.mark.parametrize("told", ["receive", "pose", "link"])
def test_session_whose_listener_raises_goes_on_without_it(told: str) -> None:
    said: list[str] = []

    def script(session: Session) -> Generator[Task, Any, Any]:
        while True:
            try:
                yield Forever()
            except OSError as error:
                said.append(str(error))

    session = Session(script)
    session.step(0)
    listener = session.listener = FullDisk()
    listener.deadline_us = 0 if told == "link" else 1 << 62
    heartbeat = Codec(*m.VEHICLE).encode(m.vehicle_heartbeat(1, armed=False))
    for k in range(1, 4):
        session.step(1000 * k, heartbeat if told == "receive" else b"", [pose(k)] if told == "pose" else [])
    assert said == [told]
    assert session.listener is None
    assert not session.done


def test_session_failed_before_its_first_step_ends() -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        yield Forever()

    session = Session(script)
    session.fail(KeyboardInterrupt())
    assert session.done


def test_session_poses_reach_the_vehicle_on_its_own_clock(run: Run, fake: Any) -> None:
    fake.clock_offset_us = 7_000_000

    def script(session: Session) -> Generator[Task, Any, Any]:
        yield SettleClock()
        for _ in range(4):
            yield SettleClock()
        while session.poses < 30:
            yield Wait()

    datagrams = [(10_000 * k + 4_000, pose(10_000 * k, float(k))) for k in range(1, 40)]
    session = run(script, fake, datagrams=datagrams)
    got = [message for message in fake.heard if isinstance(message, m.AttPosMocap)]
    assert 20 <= len(got) <= session.forwarded <= session.poses
    for message in got:
        assert message.time_usec == pytest.approx(10_000 * message.x + 7_000_000, abs=500)


class Wait(Task):
    """Ten milliseconds."""

    def begin(self, client: Client, now_us: int) -> None:
        self.deadline_us = now_us + 10_000

    def advance(self, client: Client, now_us: int) -> None:
        self.finish()


def test_session_pose_no_newer_than_the_last_is_dropped() -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        yield Forever()

    session = Session(script)
    session.step(0, b"", [pose(1000), pose(1000), pose(500), pose(2000)])
    assert session.poses == 2
    # The vehicle's clock is not known yet: nothing goes on to it.
    assert session.forwarded == 0


def test_camera_clock_with_a_declared_delay_finds_the_offset() -> None:
    camera = CameraClock(4_000)
    for k in range(100):
        camera.pose(10_000 * k + 55_000, 10_000 * k + 4_000 + (k * 37) % 500)
    assert camera.offset_us == 55_000
    assert CameraClock(None).offset_us == 0.0


def test_damaged_datagram_costs_none_of_the_next_ones() -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        yield Forever()

    session = Session(script)
    damaged = bytearray(pose(10_000))
    damaged[1] = 0xFF  # announces a payload that other datagrams would have to bring
    for k, datagram in enumerate([bytes(damaged), pose(20_000)[:20], pose(30_000)]):
        session.step(10_000 * (k + 1), b"", [datagram])
    assert session.poses == 1


@given(chunks=st.lists(st.binary(max_size=300), max_size=8), datagram=st.binary(max_size=200))
def test_session_takes_any_bytes(chunks: list[bytes], datagram: bytes) -> None:
    def script(session: Session) -> Generator[Task, Any, Any]:
        yield FindVehicle("port")

    session = Session(script)
    for k, chunk in enumerate(chunks):
        session.step(1000 * k, chunk, [datagram])
    assert not session.done


@given(data=st.data())
def test_session_takes_whole_messages_with_any_content(data: st.DataObject) -> None:
    kinds = (m.Heartbeat, m.Timesync, m.FcStatus, m.StatusText, m.RadioStats, m.CommandAck, m.ParamValue)

    def script(session: Session) -> Generator[Task, Any, Any]:
        yield Forever()

    session = Session(script)
    sender = data.draw(st.sampled_from([m.VEHICLE, m.HOST_RADIO, m.VEHICLE_RADIO, (77, 9)]))
    codec = Codec(*sender)
    for k in range(data.draw(st.integers(1, 5))):
        kind: Any = data.draw(st.sampled_from(kinds))
        size = codec.encode(_zero(kind))
        payload = data.draw(st.binary(min_size=len(size) - 12, max_size=len(size) - 12))
        session.step(1000 * k, _frame(kind, payload, sender))
    assert session.error is None


def _zero(kind: Any) -> m.Message:
    """A message of a kind with nothing in it."""
    values = []
    for name, length in zip(kind.fieldnames, _lengths(kind), strict=True):
        is_text = kind.fieldtypes[kind.fieldnames.index(name)] == "char"
        values.append(b"" if is_text else [1] * length if length else 1)
    return kind(*values)


def _lengths(kind: Any) -> list[int]:
    """Array lengths in the order of fieldnames."""
    by_name = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    return [by_name[name] for name in kind.fieldnames]


def _frame(kind: Any, payload: bytes, sender: tuple[int, int]) -> bytes:
    """A frame with a right checksum around any payload."""
    from fastcrc.crc16 import mcrf4xx

    number = kind.id
    head = bytes([len(payload), 0, 0, 0, *sender, number & 255, number >> 8 & 255, number >> 16])
    crc = mcrf4xx(head + payload + bytes([kind.crc_extra]))
    return b"\xfd" + head + payload + crc.to_bytes(2, "little")
