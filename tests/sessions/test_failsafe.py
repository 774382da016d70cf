"""Rows of the failsafe table in whole lock-step flights: what the log says, how `trimtab fly` ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest

from trimtab.firmware_model.flight.failsafe import BY_EVENT, Action
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.host import cli
from trimtab.host.link.fly import FlightEnded
from trimtab.host.log import Flight, read_flight, topics
from trimtab.host.log.scan import scan
from trimtab.protocol.blobs import Reference

STRUCK_S = 7.0
"""On the host's clock, in the tracking phase."""


def judged(flight: Flight, event: Event, *, heard: bool = True) -> None:
    """The flight was ended by the event's row: name, action, the text; it is over. heard: while it struck."""
    row = BY_EVENT[event]
    assert flight.failsafe == row.failsafe.name.lower().replace("_", "-")
    assert not flight.tracking_whole
    status, said = flight.status, [entry.data for entry in scan(flight.path).by_topic()[topics.LOG]]
    assert status is not None
    assert status.state[-1] == State.STANDBY
    failing = status.state == State.FAILSAFE
    if heard:
        assert failing.any()
        assert status.action[failing].max() == row.action
        assert any(row.text.encode() in text for text in said)
    assert not any(b"no touchdown detected" in text for text in said)
    if row.action is Action.LAND_IN_PLACE:
        assert flight.mocap is not None
        assert abs(flight.mocap.p[-1, 2]) < 0.1


def struck_us(flight: Flight) -> int:
    """When the vehicle says that FAILSAFE began, on the host's clock, to the rate of FC_STATUS."""
    assert flight.status is not None
    first = int((flight.status.state == State.FAILSAFE).argmax())
    return int(flight.status.t_us[first]) + int(flight.metadata["arm_host_us"])


WIND = """
[effects.linear-drag]
dx = 0.8
dy = 0.7
dz = 0.4
[effects.wind]
wx = 3.0
wy = 0.0
"""
# At rest 15.75 V with the seed below, in a hover 15.5 V; low is here 15.6 V.
SAG = """
[effects.battery-sag]
exponent = 1.7
"""


@pytest.mark.parametrize(
    ("event", "world", "parameters", "after_s"),
    [
        pytest.param(
            Event.MOCAP_LOST, f"[mocap]\ngaps_s = [[{STRUCK_S}, 600.0]]\n", (), 0.5, id="poses end for good"
        ),
        # Poses cross the same radio: of a link that is cut for long it is they that are missed first.
        pytest.param(
            Event.MOCAP_LOST, f"[radio]\ncuts_s = [[{STRUCK_S}, 12.0]]\n", (), None, id="link cut for long"
        ),
        pytest.param(
            Event.FENCE_LEFT, WIND, ("FENCE_N_MAX=0.75", "FS_FENCE_M=0.05", "FS_FENCE_S=0.1"), None, id="wind"
        ),
        pytest.param(Event.BATTERY_LOW, SAG, ("FS_BAT_SHARE=0.667",), None, id="battery"),
        pytest.param(Event.TILTED, "", ("FS_TILT_DEG=10", "FS_TILT_S=0.1"), None, id="tilt"),
    ],
)
def test_fly_exits_with_1_and_the_log_names_the_row(
    event: Event,
    world: str,
    parameters: tuple[str, ...],
    after_s: float | None,
    world_file: Callable[[str], str],
    reference: Reference,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eight.ref").write_bytes(reference.to_bytes())
    set_on_board = [word for setting in parameters for word in ("--parameter", setting)]
    words = ["fly", "eight.ref", "--world", world_file(world), "--world-seed", "8640", *set_on_board]
    monkeypatch.setattr("sys.argv", ["trimtab", *words])
    assert cli.main([*words, "-o", "x.mcap", "--json"]) == 1
    told = capsys.readouterr()
    flight = read_flight(tmp_path / "x.mcap")
    assert json.loads(told.out.strip().splitlines()[-1])["failsafe"] == flight.failsafe
    assert "ended in failsafe: " in told.err
    judged(flight, event, heard="cuts_s" not in world)
    if after_s is not None:
        row = BY_EVENT[event]
        assert row.timeout is not None
        assert 1e-6 * struck_us(flight) == pytest.approx(STRUCK_S + after_s, abs=0.12)


def busy(simulated: Any) -> None:
    """From now on three ticks in ten take longer than a tick."""
    timing = simulated._timing
    timing._settings = timing._settings.model_copy(update={"overrun": 0.3})


def frozen(simulated: Any) -> None:
    """From now on the IMU repeats one sample."""
    sample = simulated._sensed.tolist()
    simulated._sensed = sample
    simulated._imu_errors = cycle([(0.0,) * 7])
    simulated._tick_devices = simulated._devices()


@pytest.mark.parametrize(("event", "spoil"), [(Event.LOOP_OVERRUN, busy), (Event.IMU_STUCK, frozen)])
def test_flight_whose_processor_fails_it_ends_by_the_row(
    event: Event,
    spoil: Callable[[Any], None],
    fly: Callable[..., Any],
    simulate: Callable[..., Any],
) -> None:
    simulated = simulate(world_seed=8641)
    with pytest.raises(FlightEnded, match="ended in failsafe") as caught:
        fly(simulated, on_phase=lambda phase: spoil(simulated) if phase == "tracking" else None)
    assert caught.value.exit_code == 1
    judged(read_flight(caught.value.result.log), event)


def seen_first(simulated: Any, state: State, act: Callable[[Any, int], None]) -> None:
    """Call `act` with the flight and the time, once, when the vehicle is in `state`."""
    run, waiting = simulated.run_until, [act]

    def watch(t_us: int) -> int:
        now_us = run(t_us)
        flight = simulated._flight_mcu.flight
        if waiting and flight.state is state:
            waiting.pop()(flight, now_us)
        return now_us

    simulated.run_until = watch


def test_flight_that_fails_between_arming_and_start_is_told_as_one(
    fly: Callable[..., Any], simulate: Callable[..., Any]
) -> None:
    simulated = simulate(world_seed=8644)
    late = BY_EVENT[Event.LOOP_OVERRUN]
    seen_first(simulated, State.ARMED, lambda flight, now_us: flight._trigger(late, now_us))
    with pytest.raises(FlightEnded, match="ended in failsafe: ticks too late") as caught:
        fly(simulated)
    flight = read_flight(caught.value.result.log)
    assert flight.failsafe == "loop-overrun"
    assert flight.tracking is None


def test_start_whose_answer_is_lost_and_that_fails_meanwhile_is_followed_down(
    fly: Callable[..., Any], simulate: Callable[..., Any], world_file: Callable[[str], str]
) -> None:
    risen: list[int] = []
    simulated = simulate(world_seed=8644, world=world_file(""))
    seen_first(simulated, State.TAKEOFF, lambda flight, now_us: risen.append(now_us))
    fly(simulated)
    cut = f"[radio]\ncuts_s = [[{risen[0] / 1e6 + 0.001:.3f}, 1.2]]\n"
    with pytest.raises(FlightEnded, match="ended in failsafe: mocap lost") as caught:
        fly(simulate(world_seed=8644, world=world_file(cut)))
    flight = read_flight(caught.value.result.log)
    said = [entry.data for entry in scan(flight.path).by_topic()[topics.LOG]]
    assert any(b"start refused: " in text for text in said)
    assert flight.status is not None
    assert flight.status.state[-1] == State.STANDBY
