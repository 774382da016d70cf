"""Whole flights in lock-step: what the log says of them, and what becomes of them when things go wrong."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trimtab.host.base.errors import LinkError, Refused, UsageError
from trimtab.host.link import fly as fly_module
from trimtab.host.link.drivers import run_lockstep
from trimtab.host.link.flight import FlightDirector
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import FlightEnded, FlightInterrupted, fly_lockstep
from trimtab.host.link.parameter_tasks import SetParameter
from trimtab.host.link.session import Session
from trimtab.host.link.summary import FlightResult
from trimtab.host.link.tasks import FreshStatus
from trimtab.host.link.upload import upload_lockstep
from trimtab.host.link.vehicle_match import neutral_feedforward
from trimtab.host.log import Flight, LogError, read_flight, recover, topics
from trimtab.host.log.provenance import is_simulated
from trimtab.host.log.scan import scan
from trimtab.host.log.tracking import reference_at
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import NEUTRAL_BLOCK, FeedForward, Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.generated import flight_pb2

Flown = tuple[FlightResult, Flight]
Fly = Callable[..., FlightResult]
Simulate = Callable[..., Any]
PLANT = f"{Path(__file__).parent.parent / 'plants' / 'thermal.py'}:Thermal"


def test_session_flies_the_reference_and_logs_it(flown: Flown, reference: Reference) -> None:
    result, flight = flown
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.05
    assert flight.id == result.log_id
    assert flight.reference == reference
    assert flight.tracking_whole
    assert flight.tracking is not None
    start_us, end_us = flight.tracking
    assert end_us - start_us == reference.duration_us
    states = flight.status
    assert states is not None
    order = list(dict.fromkeys(states.state.tolist()))
    assert order[-5:] == [3, 4, 5, 6, 1]  # takeoff, tracking, hold, landing, standby
    assert order[:-5] in ([], [2])  # armed may be told with the acknowledgement that opens the log
    assert flight.firmware_parameters is not None
    assert flight.firmware_parameters["MASS"] == pytest.approx(0.752)
    assert flight.metadata["session_uid"] != "0"


def test_session_topics_come_at_their_rates(flown: Flown) -> None:
    flight = flown[1]
    assert flight.mocap is not None
    assert flight.estimate is not None
    assert flight.control is not None
    assert flight.status is not None
    assert flight.link is not None
    for track, rate_hz in ((flight.mocap, 100), (flight.estimate, 100), (flight.control, 100)):
        assert len(track) == pytest.approx(rate_hz * flight.duration_s, rel=0.05)
    assert len(flight.status) >= 9.5 * flight.duration_s
    assert len(flight.link) == pytest.approx(10 * flight.duration_s, rel=0.05)
    # Poses: measured 4 to 4.5 ms before they arrive, to the tick; both as they were.
    late = flight.mocap.t_arrival_us - flight.mocap.t_us
    assert late.min() >= 4000
    assert late.max() <= 6000


def test_session_clock_comparison_is_exact_where_both_ways_are_alike(flown: Flown) -> None:
    # The simulated vehicle's clock is the host's: the offset is known to be 0.
    link = flown[1].link
    assert link is not None
    assert abs(link.clock_offset_us[-1]) <= 500.0
    assert link.clock_offset_sd_us[-1] < 500.0


def test_session_control_means_tell_of_the_flight(flown: Flown, vehicle: Vehicle) -> None:
    flight = flown[1]
    control = flight.control
    assert control is not None
    assert flight.tracking is not None
    # Intervals join: what one message lost, the next one holds.
    np.testing.assert_array_equal(control.t0_us[1:], control.t1_us[:-1])
    inside = (control.t0_us >= flight.tracking[0]) & (control.t1_us <= flight.tracking[1])
    c1, c2 = vehicle.thrust_curve
    u = control.motor_mean[inside]
    thrust = vehicle.thrust_max_n * (c1 * u + c2 * u**2).sum(axis=1)
    # Motors, command and accelerometer say the same in their three ways, above the weight for the tilt.
    assert thrust.mean() == pytest.approx(control.collective[inside].mean(), rel=0.01)
    assert thrust.mean() == pytest.approx(-vehicle.mass_kg * control.force_mean[inside, 2].mean(), rel=0.03)
    assert 1.0 < thrust.mean() / (9.81 * vehicle.mass_kg) < 1.15
    np.testing.assert_allclose(control.gyro_mean[inside].mean(axis=0), 0.0, atol=0.05)


def test_session_logged_reference_is_the_one_flown(flown: Flown, reference: Reference) -> None:
    result, flight = flown
    entries = scan(result.log).by_topic()[topics.REFERENCE]
    messages = [flight_pb2.Reference.FromString(entry.data) for entry in entries]
    assert len(messages) >= 0.97 * (reference.duration_us * 1e-4 + 100)
    t_us = np.array([message.reference_us for message in messages])
    np.testing.assert_allclose(
        [list(message.p_ned_m) for message in messages], reference_at(reference, t_us)[:, :3], atol=1e-12
    )
    np.testing.assert_allclose(
        [list(message.j_ned_m_s3) for message in messages], reference_at(reference, t_us)[:, 9:12], atol=1e-9
    )
    assert {message.reference_id for message in messages} == {reference.id}
    assert flight.tracking is not None
    published = np.array([entry.publish_time_us for entry in entries])
    inside = t_us < reference.duration_us
    np.testing.assert_allclose(published[inside] - t_us[inside], flight.tracking[0], atol=500)


def test_session_same_seed_gives_the_same_bytes_and_another_flight_others(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    first = fly(simulate(world_seed=5), log_path=tmp_path / "a.mcap").log.read_bytes()
    again = fly(simulate(world_seed=5), log_path=tmp_path / "b.mcap").log.read_bytes()
    other = fly(simulate(world_seed=5, flight=1), log_path=tmp_path / "c.mcap").log.read_bytes()
    assert first == again
    assert first != other


@pytest.mark.parametrize(("board", "simulated"), [(m.SIMULATED_BOARD, True), (0x0203_0001, False), (0, None)])
def test_session_logs_whether_the_firmware_says_that_it_is_simulated(
    fly: Callable[..., FlightResult],
    simulate: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    board: int,
    simulated: bool | None,
) -> None:
    monkeypatch.setattr("trimtab.sitl.vehicle.SIMULATED_BOARD", board)
    assert is_simulated(read_flight(fly(simulate()).log).metadata) is simulated


def test_session_with_and_without_a_compiler_gives_the_same_bytes(
    fly: Fly,
    simulate: Simulate,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    require: Callable[[str], None],
) -> None:
    require("compiler")
    logs = []
    for engine in ("vm", "c"):
        monkeypatch.setenv("TRIMTAB_ENGINE", engine)
        logs.append(fly(simulate(world="worn"), log_path=tmp_path / f"{engine}.mcap").log.read_bytes())
    assert logs[0] == logs[1]


def test_session_after_a_power_cycle_equals_one_that_began_so(
    fly: Fly, simulate: Simulate, reference: Reference, tmp_path: Path
) -> None:
    # As in the demo: uploaded on an idle clock, power-cycled, flown. Twice the same bytes.
    logs = []
    for name in ("a.mcap", "b.mcap"):
        simulated = simulate()
        uploaded = upload_lockstep(reference, simulated)
        assert uploaded.id == reference.id
        simulated.power_cycle(3)
        assert simulated.now_us == 0
        logs.append(fly(simulated, log_path=tmp_path / name, upload=False).log.read_bytes())
    assert logs[0] == logs[1]


@pytest.mark.parametrize("wind", [pytest.param((3.0, 0.0), marks=pytest.mark.full), (-2.1, 2.1)])
def test_session_in_a_strong_wind_lands_upright(
    fly: Fly, simulate: Simulate, world_file: Callable[[str], str], wind: tuple[float, float]
) -> None:
    # The worst that a drawn world holds, twice the typical wind on twice the drag. It comes down leaning.
    drag = "[effects.linear-drag]\ndx = 0.8\ndy = 0.7\ndz = 0.4\n"
    world = world_file(f"{drag}[effects.wind]\nwx = {wind[0]}\nwy = {wind[1]}\n")
    result = fly(simulate(world=world))
    assert result.end is not None
    assert result.end.failsafe is None


@pytest.mark.parametrize(("loss", "burst"), [pytest.param(0.2, 5.0, marks=pytest.mark.full), (0.3, 20.0)])
def test_session_over_a_lossy_radio_flies_all_the_same(
    fly: Fly, simulate: Simulate, loss: float, burst: float
) -> None:
    simulated = simulate(radio={"loss": loss, "burst_frames": burst})
    result = fly(simulated)
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.06
    counts = simulated.radio_counts()
    lost = sum(way["lost"] for way in counts.values())
    # The counts in the result begin at arm and end with the radios' last report.
    link = result.link
    assert 0.6 * lost <= link["frames_lost"] <= lost
    for way in ("up", "down"):
        gone = counts[way]["lost"] / counts[way]["sent"]
        assert link[f"{way}_lost_share"] == pytest.approx(gone, abs=0.05), way
        assert link[f"{way}_lost"] < counts[way]["lost"] + 10
    assert link == read_flight(result.log).to_dict()["link"]
    assert 5.0 < link["rtt_ms"] < link["rtt_ms_p99"] < 200.0
    assert 10.0 < link["mocap_age_ms_p50"] < link["mocap_age_ms_p99"] <= link["mocap_age_ms_max"] + 1.0
    # A pose travels in a frame of its own, of which somewhat fewer are lost than of full ones.
    assert 0.4 * loss < link["poses_lost"] / (100.0 * result.duration_s) < loss
    assert link["telemetry_gap_ms"] >= 30.0
    assert link["broken"] == link["overruns"] == link["refused"] == 0
    assert 4_000 < link["bytes_up_s"] < 8_000
    assert 10_000 < link["bytes_down_s"] < 20_000
    flight = read_flight(result.log)
    assert flight.control is not None
    intervals = np.unique(flight.control.t1_us - flight.control.t0_us)
    assert len(intervals) > 1  # lost messages widened some
    np.testing.assert_array_equal(flight.control.t0_us[1:], flight.control.t1_us[:-1])


def test_session_with_another_vehicle_is_refused_before_anything_is_written(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r"vehicle is the nano \(\w+\), the reference is for "):
        fly(simulate(vehicle=load_vehicle("nano")))
    assert not list(tmp_path.iterdir())


def test_order_for_another_vehicle_than_the_references_is_refused(reference: Reference) -> None:
    with pytest.raises(UsageError, match="was made for vehicle"):
        FlightRequest(vehicle=load_vehicle("nano"), reference=reference, log_path=Path("x.mcap"))


def test_session_with_other_parameters_on_board_needs_as_flashed(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    def script(session: Session) -> Any:
        yield FreshStatus()
        return (yield SetParameter("POS_P_N", 5.5))

    simulated = simulate()
    session = Session(script)
    run_lockstep(session, simulated)
    assert session.error is None
    simulated.power_cycle(0)
    with pytest.raises(UsageError, match=r"POS_P_N is 5\.5.*give the vehicle file.*--as-flashed"):
        fly(simulated)
    assert not list(tmp_path.iterdir())
    simulated.power_cycle(0)
    result = fly(simulated, as_flashed=True)
    parameters = read_flight(result.log).firmware_parameters
    assert parameters is not None
    assert parameters["POS_P_N"] == 5.5


def test_session_with_parameters_sets_them_on_board_and_tells_the_log(fly: Fly, simulate: Simulate) -> None:
    simulated = simulate()
    flight = read_flight(fly(simulated, parameters={"OBS_GAIN": 3.0}).log)
    assert flight.firmware_parameters is not None
    assert flight.firmware_parameters["OBS_GAIN"] == 3.0
    assert flight.observer is not None
    assert flight.control is not None
    # One for each control message but those that came without their companion.
    assert len(flight.control) - 50 < len(flight.observer) <= len(flight.control) + 1
    assert set(flight.observer.t_us) - {int(flight.observer.t_us[0])} <= set(flight.control.t1_us)
    seen = np.abs(flight.observer.disturbance).max(axis=0)
    assert (seen > 0.0).all()
    assert (seen < 0.5).all()

    simulated.power_cycle(0)
    with pytest.raises(UsageError, match=r"OBS_GAIN is 3, not 0.*--parameter"):
        fly(simulated)


def test_session_with_the_observer_stated_off_has_the_bytes_of_one_without(fly: Fly, flown: Flown) -> None:
    result = fly(parameters={"OBS_GAIN": 0.0})
    assert result.log.read_bytes() == flown[0].log.read_bytes()
    assert flown[1].observer is None


def test_session_reference_refused_on_board_names_node_and_reason(
    fly: Fly, figure_eight: Callable[..., Reference], vehicle: Vehicle, tmp_path: Path
) -> None:
    with pytest.raises(Refused, match=r"refused on board at node \d+"):
        fly(reference=figure_eight(vehicle, duration_s=1.5, size_m=2.0))
    assert not list(tmp_path.iterdir())


def test_session_without_upload_needs_the_reference_on_board(fly: Fly, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"on board is none.*trimtab upload"):
        fly(upload=False)
    assert not list(tmp_path.iterdir())


def test_session_with_a_feedforward_logs_it_and_without_refuses_it(
    fly: Fly, simulate: Simulate, vehicle: Vehicle, tmp_path: Path
) -> None:
    block = (*NEUTRAL_BLOCK[:4], 0.3, 0.3, 0.0, *NEUTRAL_BLOCK[7:])
    addition = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=block)
    simulated = simulate()
    result = fly(simulated, feedforward=addition)
    assert read_flight(result.log).feedforward == addition
    simulated.power_cycle(1)
    with pytest.raises(
        UsageError, match=f"{addition.id} is live on board.*--feedforward FILE.*upload neutral"
    ):
        fly(simulated, log_path=tmp_path / "without.mcap")


def test_session_after_a_neutral_upload_flies_as_without_feedforward(
    fly: Fly, simulate: Simulate, vehicle: Vehicle, flown: tuple[FlightResult, Flight]
) -> None:
    addition = FeedForward(vehicle_id=vehicle.id, model_id="0" * 12, block=(1.1, *NEUTRAL_BLOCK[1:]))
    simulated = simulate()
    upload_lockstep(addition, simulated)
    uploaded = upload_lockstep(None, simulated)
    assert (uploaded.kind, uploaded.id) == ("feedforward", neutral_feedforward(vehicle.id).id)
    simulated.power_cycle(0)
    result = fly(simulated)
    flight = read_flight(result.log)
    assert flight.feedforward is None
    assert flight.status is not None
    assert result.tracking_rmse_m == flown[0].tracking_rmse_m


def test_session_that_loses_mocap_ends_in_failsafe_with_its_log_kept(
    fly: Fly, simulate: Simulate, world_file: Callable[[str], str]
) -> None:
    simulated = simulate(world=world_file("[mocap]\ngaps_s = [[7.0, 20.0]]\n"))
    with pytest.raises(FlightEnded, match="failsafe: mocap lost") as caught:
        fly(simulated)
    assert caught.value.exit_code == 1
    result = caught.value.result
    flight = read_flight(result.log)
    assert flight.failsafe == "mocap-lost"
    assert not flight.tracking_whole
    assert result.to_dict()["failsafe"] == "mocap-lost"


def restamped(simulated: Any, stamp: Callable[[int, int], list[int]]) -> Any:
    """The vehicle, whose cameras send each pose with the stamps that `stamp` makes of (stamp, now), in us."""
    read, codec = simulated.mocap_read, Codec(*m.CAMERAS)

    def mocap_read() -> list[bytes]:
        poses: list[Any] = [message for datagram in read() for message in Codec(*m.HOST).decode(datagram)]
        return [
            codec.encode(m.AttPosMocap(stamp_us, p.q, p.x, p.y, p.z))
            for p in poses
            for stamp_us in stamp(p.time_usec, simulated.now_us)
        ]

    simulated.mocap_read = mocap_read
    return simulated


@pytest.mark.parametrize("wrong_us", [2**64 - 1, pytest.param(2**63 - 1, marks=pytest.mark.full), 60_000_000])
@pytest.mark.parametrize("delay_us", [None, 4_000])
def test_session_one_pose_with_a_wrong_stamp_does_not_end_the_flight(
    fly: Fly, simulate: Simulate, wrong_us: int, delay_us: int | None
) -> None:
    sent: list[int] = []

    def stamp(stamp_us: int, now_us: int) -> list[int]:
        if now_us < 7_000_000 or sent:
            return [stamp_us]
        sent.append(wrong_us)
        return [wrong_us, stamp_us]

    result = fly(restamped(simulate(), stamp), camera_delay_us=delay_us)
    assert sent
    assert result.end is not None
    assert result.end.whole
    mocap = read_flight(result.log).mocap
    assert mocap is not None
    assert len(mocap) == pytest.approx(100 * result.duration_s, rel=0.02)


@pytest.mark.parametrize("shift_us", [-3_000_000, 60_000_000])
def test_session_whose_cameras_clock_is_set_flies_on(fly: Fly, simulate: Simulate, shift_us: int) -> None:
    simulated = restamped(
        simulate(), lambda stamp_us, now_us: [stamp_us + (shift_us if now_us > 7_000_000 else 0)]
    )
    result = fly(simulated, camera_delay_us=4_000)
    assert result.end is not None
    assert result.end.whole
    assert result.tracking_rmse_m is not None
    assert result.tracking_rmse_m < 0.05


def test_session_that_loses_the_link_lands_and_says_so(fly: Fly, simulate: Simulate) -> None:
    simulated = simulate()
    write, host, poses = simulated.serial_write, Codec(*m.HOST), Codec(*m.HOST)

    def serial_write(data: bytes) -> None:
        if simulated.now_us > 7_000_000:  # nothing but poses leaves the host any more
            sent: list[Any] = [p for p in host.decode(data) if isinstance(p, m.AttPosMocap)]
            data = b"".join(poses.encode(m.AttPosMocap(p.time_usec, p.q, p.x, p.y, p.z)) for p in sent)
        write(data)

    simulated.serial_write = serial_write
    with pytest.raises(FlightEnded, match="failsafe: link lost") as caught:
        fly(simulated)
    assert caught.value.result.to_dict()["failsafe"] == "link-lost"
    flight = read_flight(caught.value.result.log)
    assert flight.failsafe == "link-lost"
    assert flight.mocap is not None
    assert abs(flight.mocap.p[-1, 2]) < 0.1


def test_session_whose_link_stays_away_is_given_up_with_its_log_kept(
    fly: Fly, simulate: Simulate, world_file: Callable[[str], str], tmp_path: Path
) -> None:
    simulated = simulate(world=world_file("[radio]\ncuts_s = [[6.0, 900.0]]\n"))
    with pytest.raises(LinkError, match=r"silent for 30 s.*the log up to this point is .*flight\.mcap"):
        fly(simulated)
    flight = read_flight(tmp_path / "flight.mcap")
    assert flight.mocap is not None
    assert flight.mocap.t_us[-1] > 30_000_000


@pytest.mark.parametrize(("option", "value"), [("fail_after_ticks", 7000), ("nan_after_ticks", 7000)])
def test_session_with_a_plant_that_fails_leaves_a_readable_log(
    fly: Fly, simulate: Simulate, tmp_path: Path, option: str, value: int
) -> None:
    options = tmp_path / "plant.toml"
    options.write_text(f"{option} = {value}\n", encoding="utf-8")
    with pytest.raises(Exception, match="Thermal") as caught:
        fly(simulate(plant=PLANT, plant_options=str(options)))
    assert getattr(caught.value, "exit_code", None) == 2
    flight = read_flight(tmp_path / "flight.mcap")
    assert flight.estimate is not None
    assert flight.estimate.t_us[-1] == pytest.approx(
        7_000_000 - int(flight.metadata["arm_host_us"]), abs=50_000
    )


def test_session_with_a_plant_that_fails_before_arm_leaves_a_readable_log(
    fly: Fly, simulate: Simulate, tmp_path: Path
) -> None:
    options = tmp_path / "plant.toml"
    options.write_text("fail_after_ticks = 100\n", encoding="utf-8")
    with pytest.raises(Exception, match="Thermal"):
        fly(simulate(plant=PLANT, plant_options=str(options)))
    flight = read_flight(tmp_path / "flight.mcap")
    assert flight.tracking is None
    assert flight.mocap is None


def test_session_interrupted_leaves_a_readable_log(fly: Fly, tmp_path: Path) -> None:
    def press(phase: str) -> None:
        if phase == "tracking":
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(FlightInterrupted, match=r"^its log is .*flight\.mcap$") as caught:
        fly(on_phase=press)
    told = caught.value.result.to_dict()
    assert (told["log"], told["interrupted"]) == (str(tmp_path / "flight.mcap"), True)
    flight = read_flight(tmp_path / "flight.mcap")
    assert flight.status is not None
    assert flight.status.state.max() <= 4


@pytest.fixture
def _hangs_up() -> Iterator[None]:
    """SIGHUP counts, also where the tests were started to outlive their terminal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("_hangs_up")
@pytest.mark.parametrize(
    ("first", "again"),
    [(signal.SIGINT, None), (signal.SIGTERM, signal.SIGTERM), (signal.SIGHUP, signal.SIGHUP)],
    ids=["Ctrl-C", "SIGTERM twice", "SIGHUP twice"],
)
def test_session_interrupted_with_a_director_lands_first(
    vehicle: Vehicle,
    reference: Reference,
    simulate: Simulate,
    tmp_path: Path,
    first: signal.Signals,
    again: signal.Signals | None,
) -> None:
    phases: list[str] = []

    def press(phase: str) -> None:
        phases.append(phase)
        if phase == "tracking":
            os.kill(os.getpid(), first)
        if phase == "landing" and again is not None:
            os.kill(os.getpid(), again)

    director = FlightDirector(
        FlightRequest(vehicle=vehicle, reference=reference, log_path=tmp_path / "x.mcap"), press
    )
    run_lockstep(director.session, simulate(), interrupt=director.interrupt)
    director.close()
    assert director.end is not None
    assert director.end.interrupted
    assert not director.end.whole
    assert phases[-4:] == ["landing on request", "landing", "standby", "landed"]
    flight = read_flight(tmp_path / "x.mcap")
    assert flight.mocap is not None
    assert abs(flight.mocap.p[-1, 2]) < 0.1
    assert not flight.tracking_whole


def test_session_interrupted_twice_leaves_the_vehicle_to_its_failsafe(
    vehicle: Vehicle, reference: Reference, simulate: Simulate, tmp_path: Path
) -> None:
    phases: list[str] = []

    def press(phase: str) -> None:
        phases.append(phase)
        if phase in ("tracking", "landing"):
            os.kill(os.getpid(), signal.SIGINT)

    order = FlightRequest(vehicle=vehicle, reference=reference, log_path=tmp_path / "x.mcap")
    simulated = simulate()
    with pytest.raises(FlightInterrupted, match=r"left to its failsafe; its log is .*x\.mcap") as caught:
        fly_lockstep(order, simulated, realtime=True, on_phase=press)
    assert phases[-1] == "landing"
    assert simulated.true_position()[2] < -0.3
    assert caught.value.result.end is None
    status = read_flight(tmp_path / "x.mcap").status
    assert status is not None
    assert [int(state) for state in status.state[-2:]] == [4, 6]  # tracking, landing


@pytest.mark.parametrize("at_a_port", [False, True], ids=["real time", "port"])
def test_session_interrupted_again_while_its_log_is_closed_keeps_log_and_answer(
    vehicle: Vehicle,
    reference: Reference,
    simulate: Simulate,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    at_a_port: bool,
) -> None:
    close, summed = FlightDirector.close, fly_module.summarise
    pressed: list[str] = []

    def press(what: str) -> None:
        pressed.append(what)
        os.kill(os.getpid(), signal.SIGINT)

    def pressed_close(director: FlightDirector) -> None:
        press("close")
        close(director)

    def pressed_summarise(*of: Any) -> FlightResult:
        press("summarise")
        return summed(*of)

    def on_phase(phase: str) -> None:
        if phase in ("tracking", "landing"):
            press(phase)

    simulated = simulate()
    monkeypatch.setattr(FlightDirector, "close", pressed_close)
    monkeypatch.setattr(fly_module, "summarise", pressed_summarise)
    monkeypatch.setattr(fly_module, "Cameras", lambda url: simulated)
    monkeypatch.setattr(fly_module, "open_port", lambda url: simulated)
    monkeypatch.setattr(
        fly_module, "run_port", lambda session, line, cameras, **how: run_lockstep(session, line, **how)
    )
    order = FlightRequest(vehicle=vehicle, reference=reference, log_path=tmp_path / "x.mcap")

    def flight() -> FlightResult:
        if at_a_port:
            return fly_module.fly_port(order, "port", "cameras", on_phase=on_phase)
        return fly_lockstep(order, simulated, realtime=True, on_phase=on_phase)

    with pytest.raises(FlightInterrupted, match=r"left to its failsafe; its log is .*x\.mcap") as caught:
        flight()
    assert pressed == ["tracking", "landing", "close", "summarise"]
    assert caught.value.result.log == tmp_path / "x.mcap"
    assert read_flight(tmp_path / "x.mcap").tracking is not None


def test_session_with_hangups_ignored_is_not_ended_by_one(fly: Fly) -> None:
    def hang_up(phase: str) -> None:
        if phase == "tracking":
            os.kill(os.getpid(), signal.SIGHUP)

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        end = fly(on_phase=hang_up).end
    finally:
        signal.signal(signal.SIGHUP, before)
    assert end is not None
    assert end.whole


def test_session_whose_log_cannot_be_written_lands_and_leaves_what_was_written(
    fly: Fly, simulate: Simulate, full_disk: Callable[[int], AbstractContextManager[None]], tmp_path: Path
) -> None:
    simulated = simulate()
    phases: list[str] = []
    with (
        full_disk(200_000),
        pytest.raises(LogError, match=r"cannot be written.*the vehicle has landed") as caught,
    ):
        fly(simulated, on_phase=phases.append)
    assert caught.value.exit_code == 5
    assert "tracking" in phases[: phases.index("landing, the log cannot be written")]
    assert phases[-3:] == ["landing", "standby", "landed"]
    assert "hold" not in phases
    assert abs(simulated.true_position()[2]) < 0.1
    assert [path.name for path in tmp_path.iterdir()] == ["flight.mcap.part"]
    found = recover(tmp_path / "flight.mcap")
    assert found.output is not None
    assert read_flight(found.output).mocap is not None


def test_session_that_loses_log_and_link_names_no_log(
    fly: Fly, simulate: Simulate, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    simulated = simulate()

    def cut(phase: str) -> None:
        if phase == "landing, the log cannot be written":
            simulated.serial_read = bytes

    with full_disk(200_000), pytest.raises(LinkError) as caught:
        fly(simulated, on_phase=cut)
    assert "the log up to this point" not in str(caught.value)


def test_session_whose_log_cannot_be_begun_stays_on_the_floor(
    fly: Fly, simulate: Simulate, full_disk: Callable[[int], AbstractContextManager[None]], tmp_path: Path
) -> None:
    simulated = simulate()
    phases: list[str] = []
    with full_disk(100), pytest.raises(LogError, match="cannot be written"):
        fly(simulated, on_phase=phases.append)
    assert "takeoff" not in phases
    assert phases[-1] == "landed"
    assert not list(tmp_path.iterdir())


def test_session_without_poses_is_refused(
    fly: Fly, simulate: Simulate, world_file: Callable[[str], str]
) -> None:
    with pytest.raises(LinkError, match="no poses in 5 s"):
        fly(simulate(world=world_file("[mocap]\ngaps_s = [[0.0, 60.0]]\n")), cameras="udp://somewhere")


def test_fly_lockstep_leaves_the_vehicle_open(
    vehicle: Vehicle, reference: Reference, simulate: Simulate, tmp_path: Path
) -> None:
    simulated = simulate()
    for k in range(2):
        order = FlightRequest(vehicle=vehicle, reference=reference, log_path=tmp_path / f"{k}.mcap")
        fly_lockstep(order, simulated)
        simulated.power_cycle(k + 1)
    logs = [read_flight(tmp_path / f"{k}.mcap") for k in range(2)]
    assert logs[0].metadata["session_uid"] != logs[1].metadata["session_uid"]


@pytest.mark.parametrize("frozen", [False, True])
def test_fly_lockstep_leaves_the_collector_as_it_was(
    vehicle: Vehicle,
    reference: Reference,
    simulate: Simulate,
    world_file: Callable[[str], str],
    tmp_path: Path,
    frozen: bool,
) -> None:
    simulated = simulate(world=world_file("[mocap]\ngaps_s = [[0.0, 60.0]]\n"))
    order = FlightRequest(vehicle=vehicle, reference=reference, log_path=tmp_path / "flight.mcap")
    inside = []
    try:
        if frozen:
            gc.freeze()
        with pytest.raises(LinkError, match="no poses in 5 s"):
            fly_lockstep(order, simulated, on_phase=lambda phase: inside.append(gc.get_freeze_count()))
        after = gc.get_freeze_count()
    finally:
        gc.unfreeze()
    assert min(inside) > 0, "what existed before is left out while it flies"
    assert (after > 0) == frozen
