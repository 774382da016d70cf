"""Thin data: each gets the best verdict that it allows, says what it lacks, and no name that is wrong.

The shipped flights hold a thrust gain, slow motors and a late camera; hovers are flown here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from trimtab.host.effects import load_effects
from trimtab.host.link.flight_request import FlightRequest
from trimtab.host.link.fly import fly_lockstep
from trimtab.host.link.vehicle import vehicle_class
from trimtab.host.log import Flight, RecordedImu, RecordedInputs, read_flight
from trimtab.host.trace import words
from trimtab.host.trace.answer import to_json
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.result import Trace
from trimtab.host.trace.run import run
from trimtab.host.trace.sentences import sentence
from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Node, Reference

DATA = Path(__file__).parents[2] / "data"
PRESENT = {"thrust-gain", "motor-lag", "mocap-latency"}
SEEDS = (1,)
WINDY = "[effects.linear-drag]\ndx = 0.4\ndy = 0.35\ndz = 0.2\n[effects.wind]\nwx = 1.5\nwy = 0.5\n"

Change = Callable[[Flight], Flight]


def short(flight: Flight, duration_s: float) -> Flight:
    assert flight.tracking is not None
    begin = flight.tracking[0] + 3_000_000
    return replace(flight, tracking=(begin, begin + round(1e6 * duration_s)))


def without_law(flight: Flight) -> Flight:
    return replace(flight, reference=None, firmware_parameters=None)


def sampled(flight: Flight, *, every: int = 1, gyro: bool = True) -> Flight:
    """Return the flight as an imported log: sampled commands and sensors, no reference, no control law."""
    c = flight.control
    assert c is not None
    inputs = RecordedInputs(t_us=c.t1_us[::every], level="motor", motor=c.motor_mean[::every])
    imu = RecordedImu(t_us=c.t1_us, gyro=c.gyro_mean, specific_force=c.force_mean) if gyro else None
    return replace(without_law(flight), control=None, recorded_inputs=inputs, recorded_imu=imu)


def poses_alone(flight: Flight) -> Flight:
    return replace(without_law(flight), control=None)


def is_honest(result: Trace, present: set[str]) -> bool:
    """Return whether no absent effect is certain, and no present effect is excluded."""
    if result.verdict == "traced":
        return {effect.name for effect in result.effects} <= present
    return result.verdict in ("undecided", "nothing-missing")


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda f: f, Code.NO_REPEAT),
        (without_law, Code.NO_REPEAT),
        (lambda f: short(f, 3.12), Code.TRACKING_TOO_SHORT),
        (sampled, Code.SAMPLED_COMMANDS),
        (lambda f: sampled(f, every=5), Code.SLOW_COMMANDS),
        (lambda f: sampled(f, gyro=False), Code.NO_GYRO),
        (poses_alone, Code.NO_INPUTS),
    ],
    ids=["one", "no-law", "3s", "sampled", "slow", "no-gyro", "poses"],
)
@pytest.mark.parametrize("name", ["c1", pytest.param("b1", marks=pytest.mark.full)])
def test_one_short_flight_reports_its_shortcomings_and_names_no_absent_effect(
    name: str, change: Change, code: Code
) -> None:
    result = run([change(read_flight(DATA / f"{name}.mcap"))], [], load_effects())
    answer = to_json(result)
    codes = {finding["code"] for finding in answer["findings"]}
    assert code in codes, codes
    (finding, *_) = [each for each in result.all_findings if each.code is code]
    assert any(sentence(finding) in line for line in words.result_lines(result))
    assert is_honest(result, PRESENT), words.result_lines(result)


def test_less_than_three_seconds_are_refused_with_a_remedy() -> None:
    with pytest.raises(LogsRefused, match=r"usable segments of 0\.6 s; fly longer or log more") as refusal:
        run([short(read_flight(DATA / "a1.mcap"), 2.4)], [], load_effects())
    assert refusal.value.details == {"code": Code.TOO_FEW_SEGMENTS}


def test_flights_of_two_vehicles_are_refused() -> None:
    one, other = (read_flight(DATA / f"{name}.mcap") for name in ("a1", "b1"))
    heavier = replace(other, vehicle=other.vehicle.model_copy(update={"mass_kg": 0.8}))
    with pytest.raises(LogsRefused, match="trace each vehicle's logs separately") as refusal:
        run([one, heavier], [], load_effects())
    assert refusal.value.details == {"code": Code.MIXED_VEHICLES}


def hovered(folder: Path, world: str, seed: int, *, tolerances: bool = True) -> Flight:
    vehicle = load_vehicle("research")
    nodes = tuple(Node(100_000 * k, (0.0,) * 12) for k in range(81))
    reference = Reference(vehicle_id=vehicle.id, origin_ned=(0.0, 0.0, -1.2), nodes=nodes)
    file, log = folder / "world.toml", folder / f"hover{seed}.mcap"
    drawn = str(tolerances).lower()
    file.write_text(f'description = "A hover"\ntolerances = {drawn}\n{world}', encoding="utf-8")
    simulated = vehicle_class().create(vehicle, world=str(file), world_seed=seed)
    fly_lockstep(FlightRequest(vehicle=vehicle, reference=reference, log_path=log), simulated)
    return read_flight(log)


@pytest.mark.parametrize(
    ("world", "seeds"),
    [
        ("", SEEDS),
        ("[effects.thrust-gain]\ngain = 0.93\n", SEEDS),
        (WINDY, SEEDS),
        ("[effects.frame-tilt]\ntilt_x = 0.015\ntilt_y = -0.008\n", SEEDS),
        *(
            pytest.param(world, (3, 4), marks=pytest.mark.full)
            for world in (
                "",
                "[effects.thrust-gain]\ngain = 0.93\n",
                WINDY,
                "[effects.frame-tilt]\ntilt_x = 0.015\ntilt_y = -0.008\n",
                "[effects.slung-payload]\nratio = 0.08\nlength_m = 0.6\ndamping = 0.05\n",
            )
        ),
    ],
)
def test_a_hover_selects_no_effect_and_lists_hidden_effects(
    tmp_path: Path, world: str, seeds: tuple[int, ...]
) -> None:
    for seed in seeds:
        result = run([hovered(tmp_path, world, seed)], [], load_effects())
        assert result.verdict in ("undecided", "nothing-missing"), (seed, words.result_lines(result))
        if "thrust-gain" in world or "tilt" in world or "wind" in world:
            assert result.verdict == "undecided", (seed, words.result_lines(result))
        unsure = {*result.hidden, *(effect.name for effect in result.effects)}
        # In a wind that was selected, a lift of typical size is detectable.
        lift = set() if "wind" in unsure - {*result.hidden} else {"translational-lift"}
        assert {"ground-effect", "quadratic-drag", *lift} <= unsure
        codes = {finding.code for finding in result.findings}
        assert Code.HIDDEN in codes
        assert codes & {Code.TRACKING_TOO_SHORT, Code.HOVER_ONLY}
