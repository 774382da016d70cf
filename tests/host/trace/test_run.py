"""Traces of shipped flights: refused logs, sag, mutual aliases and disagreements."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trimtab.host.effects import load_effects
from trimtab.host.log import Battery, Mocap, read_flight, write_imported
from trimtab.host.trace.data.cutting import segments_of
from trimtab.host.trace.data.logs import read_logs
from trimtab.host.trace.data.signals import FlightData
from trimtab.host.trace.decision.alternatives import with_each_other
from trimtab.host.trace.decision.decide import better_but_unsupported, segment_disagreement
from trimtab.host.trace.decision.findings import Code, LogsRefused
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.gathering import segment_disagreement_nats
from trimtab.host.trace.parameters import space
from trimtab.host.trace.run import run
from trimtab.host.trace.segment_fit.fit import refit
from trimtab.host.trace.segment_fit.model import SegmentModel
from trimtab.host.trace.selection import Diagnosis
from trimtab.host.vehicle import Vehicle, load_vehicle

DATA = Path(__file__).parents[2] / "data"
VEHICLE = load_vehicle("research")


def log(
    path: Path,
    *,
    vehicle: Vehicle = VEHICLE,
    tracking_us: tuple[int, int] | None = None,
    battery: Battery | None = None,
) -> Path:
    t_us = np.arange(0, 6_000_000, 10_000)
    p, q = np.zeros((len(t_us), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))
    poses = Mocap(t_us=t_us, t_arrival_us=t_us, p=p, q=q)
    write_imported(
        path,
        vehicle=vehicle,
        mocap=poses,
        battery=battery,
        tracking_us=tracking_us,
        session={"from": path.stem},
    )
    return path


@pytest.mark.parametrize("held_out", [False, True])
def test_a_log_given_twice_is_refused(tmp_path: Path, held_out: bool) -> None:
    one = read_flight(log(tmp_path / "one.mcap"))
    again = read_flight(Path(shutil.copy(tmp_path / "one.mcap", tmp_path / "again.mcap")))
    with pytest.raises(
        LogsRefused, match=r"again\.mcap: the same flight as .*one\.mcap; give it once"
    ) as refusal:
        read_logs([one] if held_out else [one, again], [again] if held_out else [], None)
    assert refusal.value.details == {"code": Code.LOG_GIVEN_TWICE}


def test_logs_of_vehicles_that_share_a_name_are_refused_with_what_differs(tmp_path: Path) -> None:
    heavier = VEHICLE.model_copy(update={"mass_kg": 0.8})
    one = read_flight(log(tmp_path / "one.mcap"))
    other = read_flight(log(tmp_path / "other.mcap", vehicle=heavier))
    with pytest.raises(LogsRefused, match=r"other\.mcap: .*research .* mass_kg differ") as refusal:
        read_logs([one, other], [], None)
    assert refusal.value.details == {"code": Code.MIXED_VEHICLES}


def test_a_held_out_log_without_poses_in_its_tracking_phase_is_refused_first(tmp_path: Path) -> None:
    one = read_flight(log(tmp_path / "one.mcap"))
    bare = read_flight(log(tmp_path / "bare.mcap", tracking_us=(5_900_000, 5_905_000)))
    with pytest.raises(LogsRefused, match=r"bare\.mcap: fewer than 10 poses") as refusal:
        read_logs([one], [bare], None)
    assert refusal.value.details == {"code": Code.TOO_FEW_POSES}


@pytest.mark.parametrize(("sag", "candidate"), [(0.0, False), (0.004, False), (0.05, True)])
def test_sag_is_a_candidate_only_if_the_voltage_fell(tmp_path: Path, sag: float, candidate: bool) -> None:
    t_us = np.arange(0, 6_000_000, 100_000)
    volts = VEHICLE.battery.full_v * (1.0 - sag * t_us / t_us[-1])
    flight = read_flight(log(tmp_path / "one.mcap", battery=Battery(t_us=t_us, battery_v=volts)))
    effects = load_effects()
    known = {name: effects[name] for name in ("battery-sag", "linear-drag", "mass")}
    assert ("battery-sag" in run([flight], [], known).space.effects) == candidate


def test_known_aliases_selected_together_are_aliases_of_each_other() -> None:
    effects = load_effects()
    library = space(load_vehicle("research"), effects)
    named = {"linear-drag": {}, "quadratic-drag": {"wind": 0.2}, "wind": {}, "motor-lag": {}}
    aliases = with_each_other(named, library, RULES)
    assert aliases["linear-drag"] == {"quadratic-drag": 0.5}
    assert aliases["quadratic-drag"] == {"wind": 0.2, "linear-drag": 0.5}
    assert aliases["wind"] == {}  # acts through a drag, not in its place
    assert aliases["motor-lag"] == {}


def test_a_much_better_but_unsupported_set_is_reported() -> None:
    sets = {(): 0.0, ("linear-drag",): 5.0, ("linear-drag", "thrust-inflow"): 20.0}
    (finding,) = better_but_unsupported(sets, {(): 0.01, ("linear-drag",): 1.0}, RULES)
    assert finding.code is Code.BETTER_BUT_INADMISSIBLE
    assert finding.subject == ("linear-drag", "thrust-inflow")
    assert finding.value == 15.0
    close = {**sets, ("linear-drag", "thrust-inflow"): 7.0}
    assert better_but_unsupported(close, {("linear-drag",): 1.0}, RULES) == []
    assert better_but_unsupported(sets, dict.fromkeys(sets, 1.0), RULES) == []


def test_flights_with_slow_poses_are_traced_by_segments() -> None:
    """At 20 poses in a second, bins of 40 ms are often without one, so no autoregression can be fitted."""
    effects = load_effects()
    slow = []
    for name in ("a1", "a2"):
        flight = read_flight(DATA / f"{name}.mcap")
        assert flight.mocap is not None
        rare = {
            key: getattr(flight.mocap, key)[::5] for key in ("t_us", "t_arrival_us", "p", "q", "forwarded_us")
        }
        slow.append(replace(flight, mocap=replace(flight.mocap, **rare)))
    result = run(slow, [], {name: effects[name] for name in ("thrust-gain", "linear-drag")})
    assert isinstance(result.diagnosis, Diagnosis)
    assert result.diagnosis.method == "segments"
    assert Code.POSES_TOO_SLOW in {finding.code for finding in result.findings}


def test_segments_disagree_with_an_absent_effect() -> None:
    """The shipped flights hold a thrust gain and no tilted frame."""
    flight = read_flight(DATA / "a1.mcap")
    effects = load_effects()
    names = ("thrust-gain", "frame-tilt", "mass")
    library = space(flight.vehicle, {name: effects[name] for name in names})
    data, _ = segments_of([FlightData.of(flight)], rate_driven=False)
    form = SegmentModel.of(flight.vehicle, library, data)
    nothing = refit(form, data, (), None, iterations=2)
    nats = segment_disagreement_nats(form, nothing, ("frame-tilt", "thrust-gain"))
    (finding,) = segment_disagreement(nats, RULES)
    assert finding.code is Code.SEGMENTS_DISAGREE
    assert finding.subject == ("frame-tilt",)
    alone = segment_disagreement_nats(form, nothing, ("thrust-gain",))
    assert segment_disagreement(alone, RULES) == []
    assert segment_disagreement({}, RULES) == []
