"""Flights by setpoints streamed to another autopilot: whole, with loss, and with every kind of doubt."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.autopilot.doubt import Doubt
from trimtab.host.autopilot.kinds import ARDUPILOT, KINDS, PX4, AutopilotKind
from trimtab.host.base.errors import FlightFailed, LinkError, Refused, TrimtabError, UsageError
from trimtab.host.base.parts import NameTaken, open_only_part
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded, FlightInterrupted, fly_lockstep
from trimtab.host.link.summary import FlightResult
from trimtab.host.log import LogError, read_flight
from trimtab.host.vehicle import Vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import Message, mavlink

TOLERATED = 1.5
"""Greatest ratio of the tracking error to that of the same flight by an upload."""


class Line:
    """A stand-in whose messages pass a filter in each direction; None drops a message."""

    def __init__(
        self,
        inner: Any,
        *,
        up: Callable[[Message, int], Message | None] = lambda message, now_us: message,
        down: Callable[[Message, int], Message | None] = lambda message, now_us: message,
        poses: Callable[[int], bool] = lambda now_us: True,
    ) -> None:
        self.inner = inner
        self._up, self._down, self._poses = up, down, poses
        self._codecs = Codec(*m.HOST), Codec(*m.HOST), Codec(*m.VEHICLE), Codec(*m.VEHICLE)
        self.sent: list[Message] = []
        self.heard: list[Message] = []
        self.answers: list[Message] = []

    @property
    def now_us(self) -> int:
        return self.inner.now_us

    def run_until(self, t_us: int) -> int:
        return self.inner.run_until(t_us)

    def serial_write(self, data: bytes) -> None:
        messages = self._codecs[0].decode(data)
        self.sent += messages
        kept = [each for message in messages if (each := self._up(message, self.now_us)) is not None]
        self.inner.serial_write(b"".join(map(self._codecs[1].encode, kept)))

    def serial_read(self) -> bytes:
        messages = self._codecs[2].decode(self.inner.serial_read())
        kept = [each for message in messages if (each := self._down(message, self.now_us)) is not None]
        kept += self.answers
        self.answers = []
        self.heard += kept
        return b"".join(map(self._codecs[3].encode, kept))

    def mocap_read(self) -> list[bytes]:
        datagrams = self.inner.mocap_read()
        return datagrams if self._poses(self.now_us) else []

    def power_cycle(self, flight: int) -> None:
        self.inner.power_cycle(flight)

    def close(self) -> None:
        self.inner.close()

    def commands(self, number: int) -> list[Message]:
        """The commands of this number that the host sent."""
        return [each for each in self.sent if isinstance(each, m.CommandLong) and each.command == number]

    @property
    def armed(self) -> bool:
        """Whether any heartbeat said that the autopilot was armed."""
        flag = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return any(isinstance(each, m.Heartbeat) and each.base_mode & flag for each in self.heard)


@pytest.fixture
def stream(
    vehicle: Vehicle, reference: Reference, simulate: Callable[..., Any], tmp_path: Path
) -> Callable[..., tuple[FlightResult, Line]]:
    """Flies a reference by setpoints; `filters` are those of the line, `order` changes the request."""

    def run(
        kind: AutopilotKind = PX4,
        *,
        simulated: Any = None,
        filters: dict[str, Any] | None = None,
        on_phase: Callable[[str], None] | None = None,
        **order: Any,
    ) -> tuple[FlightResult, Line]:
        inner = simulate() if simulated is None else simulated
        line = Line(inner.as_autopilot(kind.name), **(filters or {}))
        lines.append(line)
        request = {"vehicle": vehicle, "reference": reference, "log_path": tmp_path / "flight.mcap"} | order
        return fly_lockstep(FlightRequest(**request, autopilot=kind), line, on_phase=on_phase), line

    lines: list[Line] = []
    run.lines = lines  # type: ignore[attr-defined]
    return run


def line_of(stream: Any) -> Line:
    """The line of the last flight, also of one that raised."""
    return stream.lines[-1]


def ended(stream: Any, expected: Doubt, **options: Any) -> FlightResult:
    """The result of a flight that the host ended for this reason."""
    with pytest.raises(FlightEnded) as caught:
        stream(**options)
    result: FlightResult = caught.value.result
    assert result.end is not None
    assert result.end.doubt is expected
    assert not result.end.whole
    assert result.to_dict()["doubt"] == str(expected)
    return result


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_reference_is_flown_to_its_end(
    stream: Any, kind: AutopilotKind, reference: Reference, fly: Callable[..., FlightResult]
) -> None:
    result, line = stream(kind)
    assert result.end is not None
    assert result.end.whole
    flight = read_flight(result.log)
    assert flight.tracking_whole
    assert flight.tracking is not None
    assert flight.tracking[1] - flight.tracking[0] == reference.duration_us
    assert flight.estimate is not None
    assert flight.metadata["autopilot"] == kind.name
    assert result.tracking_rmse_m is not None
    by_upload = fly(log_path=result.log.with_name("uploaded.mcap")).tracking_rmse_m
    assert by_upload is not None
    assert result.tracking_rmse_m < TOLERATED * by_upload
    assert result.link["mocap_age_ms_p50"] is None  # another autopilot does not tell the age of its poses
    assert bool(line.commands(mavlink.MAV_CMD_NAV_TAKEOFF)) is kind.takes_off


def test_stock_pymavlink_reads_what_the_host_sends(stream: Any, reference: Reference) -> None:
    from pymavlink.dialects.v20 import common

    _, line = stream()
    parser, codec = common.MAVLink(None), Codec(*m.HOST)
    decode: Any = parser.parse_buffer
    read = [decode(bytearray(codec.encode(each)))[0] for each in line.sent]
    assert len(read) == len(line.sent)
    setpoints = [each for each in read if each.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert all(each.type_mask == 0 and each.coordinate_frame == 1 for each in setpoints)
    assert len(setpoints) > 50 * 1e-6 * reference.duration_us
    poses = [each for each in read if each.get_type() == "VISION_POSITION_ESTIMATE"]
    stamps = [each.usec for each in poses]
    assert stamps == sorted(set(stamps))
    rate_hz = 1e6 * (len(stamps) - 1) / (stamps[-1] - stamps[0])
    assert 45.0 < rate_hz <= 50.5


@pytest.mark.parametrize(
    ("kind", "name"), [(PX4, "OFFBOARD"), (ARDUPILOT, "GUIDED")], ids=["px4", "ardupilot"]
)
def test_stock_pymavlink_names_the_mode_in_flight(stream: Any, kind: AutopilotKind, name: str) -> None:
    from pymavlink import mavutil

    _, line = stream(kind)
    beats = [each for each in line.heard if isinstance(each, m.Heartbeat)]
    assert {each.autopilot for each in beats} == {kind.number}
    modes = {mavutil.mode_string_v10(each) for each in beats if each.base_mode & 128}
    assert modes == {name, "LAND"}


def test_frames_lost_flight_ends_well(stream: Any, simulate: Callable[..., Any]) -> None:
    result, _ = stream(simulated=simulate(radio={"loss": 0.1}))
    assert result.end is not None
    assert result.end.whole


def test_same_seed_same_bytes(stream: Any, tmp_path: Path) -> None:
    logs = [stream(log_path=tmp_path / f"{k}.mcap")[0].log for k in range(2)]
    assert logs[0].read_bytes() == logs[1].read_bytes()


def remembered(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The directors that are made from now on."""
    import trimtab.host.link.fly as flying

    made, directors = flying.StreamDirector, []

    def remember(*arguments: Any) -> Any:
        directors.append(made(*arguments))
        return directors[-1]

    monkeypatch.setattr(flying, "StreamDirector", remember)
    return directors


# Doubts in flight: all end on the floor, and the log is whole.


def on_the_floor(result: FlightResult) -> None:
    flight = read_flight(result.log)
    assert flight.mocap is not None
    assert flight.mocap.p[-1, 2] == pytest.approx(0.0, abs=0.05)  # it stands on the floor


def test_poses_that_stop_land_the_vehicle(stream: Any) -> None:
    result = ended(stream, Doubt.POSES_STOPPED, filters={"poses": lambda now_us: now_us < 14_000_000})
    last = [each for each in line_of(stream).heard if isinstance(each, m.Heartbeat)][-1]
    assert not last.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert result.tracking_max_m is not None


def test_silent_autopilot_is_told_to_land(stream: Any) -> None:
    silent = range(14_000_000, 17_000_000)
    result = ended(
        stream,
        Doubt.LINK_SILENT,
        filters={"down": lambda message, now_us: None if now_us in silent else message},
    )
    on_the_floor(result)


def test_pilot_who_changes_the_mode_is_obeyed(stream: Any) -> None:
    def pilot(message: Message, now_us: int) -> Message | None:
        line = line_of(stream)
        if now_us >= 14_000_000 and not acted:
            acted.append(now_us)
            hold = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), 4.0, 3.0)
            return m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_DO_SET_MODE, 0, *hold, *(0.0,) * 4)
        if now_us >= 18_000_000 and len(acted) == 1:
            acted.append(len(line.sent))
            return m.CommandLong(*m.VEHICLE, mavlink.MAV_CMD_NAV_LAND, 0, *(0.0,) * 7)
        return message

    acted: list[int] = []
    result = ended(stream, Doubt.LEFT_MODE, filters={"up": pilot})
    on_the_floor(result)
    line = line_of(stream)
    assert not line.commands(mavlink.MAV_CMD_NAV_LAND)  # the host itself commanded nothing
    after = [each for each in line.sent if isinstance(each, m.SetPositionTarget)][-1]
    assert after.time_boot_ms < 17_000


def test_estimate_that_goes_astray_lands_the_vehicle(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message:
        if isinstance(message, m.LocalPositionNed) and now_us > 14_000_000:
            message.x += 0.6
        return message

    on_the_floor(ended(stream, Doubt.ESTIMATE_WRONG, filters={"down": down}))


def test_vehicle_far_from_the_reference_lands(stream: Any, simulate: Callable[..., Any]) -> None:
    def up(message: Message, now_us: int) -> Message:
        if isinstance(message, m.SetPositionTarget) and now_us > 14_000_000:
            message.x += 2.5
        return message

    on_the_floor(ended(stream, Doubt.FAR_OFF, filters={"up": up}))


def test_geofence_lands_the_vehicle(stream: Any, vehicle: Vehicle) -> None:
    fence = ((-3.0, 3.0), (-3.0, 3.0), (-1.35, 0.3))
    small = vehicle.model_copy(update={"limits": vehicle.limits.model_copy(update={"geofence_m": fence})})

    def up(message: Message, now_us: int) -> Message:
        if isinstance(message, m.SetPositionTarget) and now_us > 12_000_000:
            message.z -= 0.6
        return message

    from tests.sessions.conftest import figure_eight

    on_the_floor(
        ended(stream, Doubt.LEFT_FENCE, filters={"up": up}, vehicle=small, reference=figure_eight(small))
    )


def test_interrupt_lands_first(stream: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def up(message: Message, now_us: int) -> Message:
        while now_us > 14_000_000 and directors:
            directors.pop().interrupt()
        return message

    directors = remembered(monkeypatch)
    with pytest.raises(FlightInterrupted, match="the vehicle has landed") as caught:
        stream(filters={"up": up})
    on_the_floor(caught.value.result)


# Before arming: nothing is armed.


def refused(stream: Any, error: type[TrimtabError], words: str, **options: Any) -> None:
    with pytest.raises(error, match=words):
        stream(**options)
    if stream.lines:
        assert not line_of(stream).armed


def test_far_from_the_start_is_not_armed(stream: Any, simulate: Callable[..., Any]) -> None:
    refused(stream, Refused, "stands 2.0 m from the start", simulated=simulate(start_ned=(2.0, 0.0, 0.0)))


def test_position_that_differs_is_not_armed(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message:
        if isinstance(message, m.LocalPositionNed):  # as if the poses were ENU
            message.x, message.y, message.z = message.y + 0.3, message.x, -message.z
        return message

    refused(
        stream, Refused, "differs from the cameras' by [23].. mm; set EKF2_EV_CTRL", filters={"down": down}
    )


def test_yaw_that_differs_is_not_armed(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message:
        if isinstance(message, m.Attitude):
            message.yaw += math.radians(90.0)
        return message

    refused(stream, Refused, "yaw differs from the cameras' by 90 deg", filters={"down": down})


def test_no_poses_are_not_armed(stream: Any) -> None:
    refused(stream, LinkError, "no poses", filters={"poses": lambda now_us: False})


def test_poses_that_stop_before_arming_are_not_armed(stream: Any) -> None:
    refused(stream, Refused, "no poses arrive", filters={"poses": lambda now_us: now_us < 1_000_000})


def test_mode_that_is_not_taken_is_not_armed(stream: Any) -> None:
    def up(message: Message, now_us: int) -> Message | None:
        return None if isinstance(message, m.SetPositionTarget) else message

    refused(stream, Refused, "does not go to OFFBOARD: it stays in HOLD", filters={"up": up})


def test_arming_that_is_refused(stream: Any) -> None:
    def up(message: Message, now_us: int) -> Message | None:
        if isinstance(message, m.CommandLong) and message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            text = b"Preflight Fail: compass"
            line_of(stream).answers += [
                m.StatusText(mavlink.MAV_SEVERITY_CRITICAL, text, 0, 0),
                m.CommandAck(message.command, mavlink.MAV_RESULT_DENIED, 0, 0, *m.HOST),
            ]
            return None
        return message

    refused(stream, FlightFailed, "refuses to arm: Preflight Fail: compass", filters={"up": up})


def test_person_is_asked_and_obeyed(stream: Any) -> None:
    told: list[Sequence[str]] = []

    def ask(answers: list[bool | None]) -> Callable[[Sequence[str]], Callable[[], bool | None]]:
        def show(lines: Sequence[str]) -> Callable[[], bool | None]:
            told.append(lines)
            return lambda: answers.pop(0)

        return show

    refused(stream, FlightFailed, "not confirmed", ask=ask([None, None, False]))
    assert "PX4 at vehicle is ready" in told[0][0]
    result, line = stream(ask=ask([None] * 40 + [True]))
    assert result.end is not None
    assert result.end.whole
    assert line.armed


def test_other_vehicles_are_refused(stream: Any, simulate: Callable[..., Any], tmp_path: Path) -> None:
    def other(message: Message, now_us: int) -> Message:
        if isinstance(message, m.Heartbeat):
            message.autopilot = ARDUPILOT.number
        return message

    refused(stream, UsageError, r"number 3 of MAV_AUTOPILOT, not 12 \(PX4\)", filters={"down": other})
    silent = {"down": lambda message, now_us: None}
    refused(stream, LinkError, "no autopilot in 5 s, nothing was received", filters=silent)


def test_own_vehicle_needs_no_autopilot(
    vehicle: Vehicle, reference: Reference, simulate: Callable[..., Any], tmp_path: Path
) -> None:
    request = FlightRequest(
        vehicle=vehicle, reference=reference, log_path=tmp_path / "x.mcap", autopilot=PX4, port="here"
    )
    with pytest.raises(UsageError, match="here: this is a vehicle of Trimtab's own firmware"):
        fly_lockstep(request, simulate())
    assert not list(tmp_path.iterdir())


def test_reference_beyond_a_limit_is_refused(
    stream: Any, vehicle: Vehicle, figure_eight: Callable[..., Reference]
) -> None:
    """The vehicle's own firmware would refuse it. Another autopilot flies what it gets."""
    for wild, words in (
        (figure_eight(vehicle, size_m=20.0), "node 8 at"),
        (figure_eight(vehicle, duration_s=4.5), "body rate"),
    ):
        refused(stream, Refused, f"breaks a limit of research, .*{words}", reference=wild)


# From the command to arm on: the vehicle is disarmed at the end, whatever happens.


def is_command(message: Message, number: int) -> bool:
    return isinstance(message, m.CommandLong) and message.command == number


def is_ack(message: Message, number: int) -> bool:
    return isinstance(message, m.CommandAck) and message.command == number


def disarmed(stream: Any) -> None:
    """The last heartbeat says that the autopilot is disarmed, and one before that it was armed."""
    line = line_of(stream)
    assert line.armed
    last = [each for each in line.heard if isinstance(each, m.Heartbeat)][-1]
    assert not last.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_acknowledgement_of_arming_that_is_lost(stream: Any, kind: AutopilotKind) -> None:
    lost = {
        "down": lambda message, now_us: (
            None if is_ack(message, mavlink.MAV_CMD_COMPONENT_ARM_DISARM) else message
        )
    }
    result, _ = stream(kind, filters=lost)
    assert result.end is not None
    assert result.end.whole  # the heartbeat says it too


def test_interrupt_while_arming(stream: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def down(message: Message, now_us: int) -> Message | None:
        if is_ack(message, mavlink.MAV_CMD_COMPONENT_ARM_DISARM):
            while directors:
                directors.pop().interrupt()
            return None
        return message

    directors = remembered(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        stream(filters={"down": down})
    disarmed(stream)


def test_log_that_has_no_folder_is_refused_before_arming(stream: Any, tmp_path: Path) -> None:
    refused(stream, UsageError, "its folder does not exist", log_path=tmp_path / "missing" / "x.mcap")


def test_log_that_another_process_writes_is_refused_before_arming(stream: Any, tmp_path: Path) -> None:
    with closing(open_only_part(tmp_path / "x.mcap")):
        refused(stream, NameTaken, "another process is writing it", log_path=tmp_path / "x.mcap")


def test_log_that_cannot_be_begun_disarms(stream: Any, full_disk: Any, tmp_path: Path) -> None:
    with full_disk(0), pytest.raises(LogError, match=r"x\.mcap: cannot be written \(.*try again"):
        stream(log_path=tmp_path / "x.mcap")
    disarmed(stream)
    assert not list(tmp_path.iterdir())


def test_pilot_who_changes_the_mode_before_arming_is_obeyed(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message:
        if isinstance(message, m.Heartbeat) and line_of(stream).commands(mavlink.MAV_CMD_DO_SET_MODE):
            message.custom_mode = 3 << 16  # POSCTL
        return message

    refused(stream, Refused, "went to POSCTL", filters={"down": down})
    assert not line_of(stream).commands(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)


def test_problem_after_the_confirmation_refuses(stream: Any) -> None:
    asked: list[int] = []

    def ask(lines: Sequence[str]) -> Callable[[], bool]:
        asked.append(1)
        return lambda: True

    def down(message: Message, now_us: int) -> Message:
        if isinstance(message, m.LocalPositionNed) and asked:  # somebody moves the vehicle
            message.vx = 0.5
        return message

    refused(stream, Refused, "its estimate moves on the floor", filters={"down": down}, ask=ask)


def test_copies_of_a_take_off_are_refused_by_a_climbing_vehicle(stream: Any) -> None:
    """ArduPilot answers FAILED to a second command once it has left the floor; the first answer was lost."""

    def down(message: Message, now_us: int) -> Message:
        if is_ack(message, mavlink.MAV_CMD_NAV_TAKEOFF):
            message.result = mavlink.MAV_RESULT_FAILED  # type: ignore[attr-defined]
        return message

    result, _ = stream(ARDUPILOT, filters={"down": down})
    assert result.end is not None
    assert result.end.whole


def test_take_off_that_does_not_happen_disarms(stream: Any) -> None:
    dropped = {
        "up": lambda message, now_us: None if is_command(message, mavlink.MAV_CMD_NAV_TAKEOFF) else message
    }
    ended(stream, Doubt.NO_TAKEOFF, kind=ARDUPILOT, filters=dropped)
    disarmed(stream)
    assert len(line_of(stream).commands(mavlink.MAV_CMD_NAV_TAKEOFF)) > 5


def test_heartbeats_that_stop_land_the_vehicle(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message | None:
        silent = 14_000_000 < now_us < 22_000_000
        return None if silent and isinstance(message, m.Heartbeat) else message

    on_the_floor(ended(stream, Doubt.LINK_SILENT, filters={"down": down}))


def test_silent_autopilot_gets_few_commands(stream: Any) -> None:
    """A pilot may have it; then the host must not take it back."""
    silent = range(14_000_000, 24_000_000)
    filters = {"down": lambda message, now_us: None if now_us in silent else message}
    ended(stream, Doubt.LINK_SILENT, filters=filters)
    assert len(line_of(stream).commands(mavlink.MAV_CMD_DO_SET_MODE)) < 20


def test_landing_is_not_repeated_once_it_is_acknowledged(stream: Any) -> None:
    _, line = stream()
    landings = [each for each in line.commands(mavlink.MAV_CMD_DO_SET_MODE) if each.param2 == 4.0]  # type: ignore[attr-defined]
    assert len(landings) == 1
    assert not line.commands(mavlink.MAV_CMD_NAV_LAND)


def test_landing_mode_that_is_refused_is_followed_by_the_command_to_land(stream: Any) -> None:
    def up(message: Message, now_us: int) -> Message | None:
        if is_command(message, mavlink.MAV_CMD_DO_SET_MODE) and message.param2 == 4.0:  # type: ignore[attr-defined]
            line_of(stream).answers.append(
                m.CommandAck(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_RESULT_DENIED, 0, 0, *m.HOST)
            )
            return None
        return message

    result, line = stream(filters={"up": up})
    assert result.end is not None
    assert result.end.whole
    assert len(line.commands(mavlink.MAV_CMD_NAV_LAND)) == 1


def test_yaw_that_goes_astray_lands_the_vehicle(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message:
        if isinstance(message, m.Attitude) and now_us > 14_000_000:
            message.yaw += math.radians(60.0)
        return message

    on_the_floor(ended(stream, Doubt.ESTIMATE_WRONG, filters={"down": down}))


def test_estimate_that_stops_lands_the_vehicle(stream: Any) -> None:
    def down(message: Message, now_us: int) -> Message | None:
        return None if isinstance(message, m.LocalPositionNed) and now_us > 14_000_000 else message

    on_the_floor(ended(stream, Doubt.ESTIMATE_WRONG, filters={"down": down}))


def test_broken_poses_are_not_forwarded(stream: Any, reference: Reference, vehicle: Vehicle) -> None:
    from trimtab.host.autopilot.director import StreamDirector

    director = StreamDirector(
        FlightRequest(vehicle=vehicle, reference=reference, log_path=Path("x"), autopilot=PX4)
    )
    forward = director._forward
    good = m.AttPosMocap(0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    assert forward(good, 0, None) is not None
    for k, broken in enumerate(
        (
            m.AttPosMocap(0, [math.nan, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0),
            m.AttPosMocap(0, [0.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0),
            m.AttPosMocap(0, [1.0, 0.0, 0.0, 0.0], math.inf, 0.0, 0.0),
        )
    ):
        assert forward(broken, 1_000_000 * (k + 1), None) is None
    assert forward(good, 10_000_000, None) is not None


def test_observer_that_fails_does_not_end_the_flight(stream: Any) -> None:
    def on_phase(phase: str) -> None:
        raise RuntimeError(phase)

    result, _ = stream(on_phase=on_phase)
    assert result.end is not None
    assert result.end.whole
