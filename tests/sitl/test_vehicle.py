"""Whole simulated flights over serial bytes and camera datagrams; what seeds and power cycles do to them."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from trimtab.firmware_model.law.reference import septic
from trimtab.host.vehicle import ConfigurationError, load_vehicle
from trimtab.protocol.blobs import Reference
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, HOST_RADIO, FcStatus, RadioStats
from trimtab.sitl.foreign import ForeignPlant, ForeignPlantError
from trimtab.sitl.vehicle import SimulatedVehicle

THERMAL = f"{Path(__file__).parent.parent / 'plants' / 'thermal.py'}:Thermal"
WHOLE_FLIGHT = [0, 1, 2, 3, 4, 5, 6, 1]
BOOT_TO_HOVER_S = 5.0


def tracking_errors(session, reference: Reference) -> np.ndarray:
    """Distance from the reference at every instant of tracking that the session saw."""
    start_us = (
        next(m.reference_tick for m in session.messages if isinstance(m, FcStatus) and m.state == 4) * 1000
    )
    nodes = reference.nodes_ned()
    errors = []
    for t_us, p in zip(session.tracked_us, session.tracked_ned, strict=True):
        s_us = t_us - start_us
        if 0 <= s_us < reference.duration_us:
            i = next(k for k in range(len(nodes) - 1) if s_us < nodes[k + 1].t_us)
            dt_s = (nodes[i + 1].t_us - nodes[i].t_us) * 1e-6
            wanted = septic(dt_s, (s_us - nodes[i].t_us) * 1e-6, nodes[i].state, nodes[i + 1].state)[0]
            errors.append(math.dist(wanted, p))
    return np.array(errors)


@pytest.mark.parametrize(("name", "size_m"), [("research", 2.4), ("nano", 1.2)])
def test_flight_in_an_empty_world_tracks_within_centimetres(name: str, size_m: float, session_tools) -> None:
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle(name)
    reference = figure_eight(vehicle, size_m=size_m)
    simulated = SimulatedVehicle.create(vehicle, world="empty", world_seed=1)
    put_on_board(simulated, reference)
    session = fly(simulated)
    errors = tracking_errors(session, reference)
    assert session.states == WHOLE_FLIGHT
    assert len(errors) > 500
    assert math.sqrt(np.mean(errors**2)) < 0.03
    assert errors.max() < 0.06
    assert abs(simulated.true_position()[2]) < 0.02


def test_same_seeds_give_the_same_bytes_compiled_or_not(session_tools, monkeypatch, require) -> None:
    require("compiler")
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research")
    reference = figure_eight(vehicle)
    received = []
    for engine, flight in (("c", 0), ("vm", 0), ("c", 1)):
        monkeypatch.setenv("TRIMTAB_ENGINE", engine)
        simulated = SimulatedVehicle.create(vehicle, world="drawn", world_seed=4, flight=flight)
        put_on_board(simulated, reference, flight)
        received.append(bytes(fly(simulated, until_s=7.0).received))
    assert len(received[0]) > 100_000
    assert received[0] == received[1]
    assert received[0] != received[2]


def test_power_cycle_starts_as_fresh_as_a_new_vehicle(session_tools) -> None:
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research")
    reference = figure_eight(vehicle)
    runs = []
    for idle_us in (0, 3_137_000):
        simulated = SimulatedVehicle.create(vehicle, world="empty", world_seed=2, flight=8)
        while simulated.now_us < idle_us:
            simulated.run_until(idle_us)
            simulated.serial_read()
            simulated.mocap_read()
        put_on_board(simulated, reference, 5)
        assert simulated.now_us == 0
        runs.append(bytes(fly(simulated, until_s=4.0).received))
    assert runs[0] == runs[1]


def test_run_until_returns_as_soon_as_something_waits_for_the_host() -> None:
    simulated = SimulatedVehicle.create(load_vehicle("research"))
    stops, datagrams, data = [], 0, 0
    while simulated.now_us < 1_000_000:
        stops.append(simulated.run_until(1_000_000))
        data += len(simulated.serial_read())
        datagrams += len(simulated.mocap_read())
    assert datagrams == pytest.approx(99, abs=2)
    assert data > 10_000
    assert len(stops) > 150
    assert stops[-1] == 1_000_000
    assert all(b > a for a, b in pairwise(stops))


def test_fast_cameras_over_scarce_slots_lose_no_pose_to_a_newer_one(session_tools, tmp_path: Path) -> None:
    _, _, fly = session_tools
    world = tmp_path / "fast.toml"
    world.write_text(
        'description = "200 poses, 166 slots a second each way"\ntolerances = false\n'
        "[mocap]\nrate_hz = 200\ndropout = 0.0\n[radio]\nslot_us = 3000\nloss = 0.0\ncorrupt = 0.0\n"
    )
    session = fly(SimulatedVehicle.create(load_vehicle("research"), world=str(world)), until_s=3.0)
    messages = Codec(*HOST).decode(bytes(session.received))
    stats = [m for m in messages if isinstance(m, RadioStats) and m.get_srcSystem() == HOST_RADIO[0]]
    assert stats[-1].replaced == 0
    assert stats[-1].messages_sent > 200 * 1.5


def test_mocap_lost_in_flight_ends_in_a_controlled_descent(session_tools) -> None:
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research")
    cut = {"cuts_s": [[BOOT_TO_HOVER_S + 2.0, 30.0]]}
    simulated = SimulatedVehicle.create(vehicle, world="quiet", radio=cut)
    put_on_board(simulated, figure_eight(vehicle))
    fly(simulated, until_s=BOOT_TO_HOVER_S + 2.0)
    assert simulated.true_position()[2] < -0.5
    while simulated.now_us < 20_000_000:
        simulated.run_until(20_000_000)
        simulated.serial_read()
        simulated.mocap_read()
    assert abs(simulated.true_position()[2]) < 0.05
    assert simulated.radio_counts()["down"]["cut"] > 100


def test_flight_on_a_foreign_plant_goes_through(session_tools, tmp_path: Path) -> None:
    figure_eight, put_on_board, fly = session_tools
    vehicle = load_vehicle("research")
    options = tmp_path / "options.toml"
    options.write_text("strength_m_s2 = 1.2\n")
    simulated = SimulatedVehicle.create(vehicle, plant=THERMAL, plant_options=str(options))
    reference = figure_eight(vehicle, omega=1.0)
    put_on_board(simulated, reference)
    session = fly(simulated)
    errors = tracking_errors(session, reference)
    assert session.states == WHOLE_FLIGHT
    assert 0.02 < errors.max() < 0.3  # the rising air shows
    assert simulated.truth()["plant"] == "thermal.py:Thermal"


def test_foreign_plant_that_raises_ends_the_flight_with_its_name(session_tools, tmp_path: Path) -> None:
    _, _, fly = session_tools
    options = tmp_path / "options.toml"
    options.write_text("fail_after_ticks = 1500\n")
    simulated = SimulatedVehicle.create(load_vehicle("research"), plant=THERMAL, plant_options=str(options))
    with pytest.raises(ForeignPlantError, match=r"thermal\.py:Thermal"):
        fly(simulated)
    assert simulated.now_us == 1_500_000


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"plant_options": "x.toml"}, "without a plant"),
        ({"radio": {"loss": 1.5, "speed": 2}}, "radio: speed: unknown key"),
        ({"world": "nirvana"}, "no such world"),
    ],
)
def test_vehicle_with_contradicting_options_is_refused(arguments: dict, told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        SimulatedVehicle.create(load_vehicle("research"), **arguments)


def test_foreign_plant_that_takes_no_world_is_refused_in_one() -> None:
    with pytest.raises(ForeignPlantError, match=r"thermal\.py:Thermal takes no world; leave out the world"):
        SimulatedVehicle.create(load_vehicle("research"), world="empty", plant=THERMAL)


def test_foreign_plant_in_a_world_gets_it_and_its_cameras_act_it_out(tmp_path: Path) -> None:
    path = tmp_path / "late.toml"
    path.write_text(
        'description = "late and tilted"\ntolerances = false\n[effects.mocap-latency]\nlatency_s = 0.02\n'
        "[effects.frame-tilt]\ntilt_x = 0.01\ntilt_y = 0.02\n[effects.mass]\nfactor = 1.1\n"
    )
    placed = f"{THERMAL.removesuffix('Thermal')}Placed"
    simulated = SimulatedVehicle.create(load_vehicle("research"), world=str(path), plant=placed)
    plant = simulated._step_owner
    assert isinstance(plant, ForeignPlant)
    assert set(plant._body.effects) == {"mocap-latency", "frame-tilt", "mass"}
    assert simulated._camera._latency_us == 20_000
    assert simulated._camera._tilt == (0.01, 0.02)
    assert simulated.truth()["effects"]["mass"] == {"factor": 1.1}
    alone = SimulatedVehicle.create(load_vehicle("research"), world_seed=7, plant=THERMAL)
    assert alone._camera._latency_us == 0.0


def test_profile_knows_every_part() -> None:
    simulated = SimulatedVehicle.create(load_vehicle("research"))
    assert simulated.profile() == {}
    simulated.start_profile()
    while simulated.now_us < 100_000:
        simulated.run_until(100_000)
        simulated.serial_read()
        simulated.mocap_read()
    parts = {"plant", "flight processor", "camera", "channel", "ground radio", "vehicle radio"}
    assert set(simulated.profile()) == parts
    assert all(seconds > 0.0 for seconds in simulated.profile().values())
