"""A vehicle's memory in a file: what a killed process leaves, and files that are none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from trimtab.firmware_model.storage.store import MAGIC, memory_bytes
from trimtab.host.vehicle import ConfigurationError, load_vehicle
from trimtab.protocol.blobs import Kind
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, ParamRequestRead, ParamSet, ParamValue
from trimtab.sitl.memory import open_memory
from trimtab.sitl.vehicle import SimulatedVehicle

VEHICLE = load_vehicle("research")


def left_by(path: Path) -> Path:
    """A copy of the file as it is now, which is what a process that was killed leaves."""
    copy = path.with_suffix(".left")
    copy.write_bytes(path.read_bytes())
    return copy


def test_new_file_is_a_memory_and_keeps_every_write_at_once(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.memory"
    store = open_memory(path, VEHICLE)
    assert path.stat().st_size == memory_bytes()
    assert os.listdir(tmp_path) == [path.name]
    store.stage(Kind.REFERENCE, b"one")
    store.commit(Kind.REFERENCE)
    store.settings.keep(VEHICLE.id_bytes, {"POS_P_N": 4.0})
    left = open_memory(left_by(path), VEHICLE)
    assert left.live(Kind.REFERENCE) == b"one"
    assert left.settings.values == {"POS_P_N": 4.0}


def test_simulated_vehicle_lets_go_of_the_file_when_closed(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.memory"
    simulated = SimulatedVehicle.create(VEHICLE, memory=path)
    simulated.store.stage(Kind.REFERENCE, b"one")
    with pytest.raises(ConfigurationError, match="in use by another simulated vehicle"):
        SimulatedVehicle.create(VEHICLE, memory=path)
    simulated.power_cycle(1)
    simulated.close()
    again = SimulatedVehicle.create(VEHICLE, memory=path)
    again.close()


def test_memory_of_another_vehicle_file_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.memory"
    SimulatedVehicle.create(VEHICLE, memory=path).close()
    before = path.read_bytes()
    with pytest.raises(ConfigurationError, match=f"belongs to the vehicle file with id {VEHICLE.id}"):
        SimulatedVehicle.create(load_vehicle("nano"), memory=path)
    assert path.read_bytes() == before


def test_file_that_is_no_memory_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    for content in (b"", b"notes", bytes(memory_bytes()), MAGIC, MAGIC + bytes(memory_bytes())):
        path = tmp_path / "file"
        path.write_bytes(content)
        with pytest.raises(ConfigurationError, match=r"file: not a memory of this version"):
            open_memory(path, VEHICLE)
        assert path.read_bytes() == content


def test_path_that_cannot_hold_a_memory_is_refused(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_text("x")
    for name, why in (
        (".", "Is a directory"),
        ("none/file", "No such file or directory"),
        ("file/below", "Not a directory"),
        ("loop", "symbolic links"),
        ("pipe", "not a regular file"),
    ):
        with pytest.raises(ConfigurationError, match=why):
            open_memory(tmp_path / name, VEHICLE)


def test_memory_damaged_behind_its_beginning_boots_with_nothing_live(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(MAGIC.ljust(memory_bytes(), b"\x5a"))
    simulated = SimulatedVehicle.create(VEHICLE, memory=path)
    while simulated.now_us < 100_000:
        simulated.run_until(100_000)
    assert simulated.store.live(Kind.REFERENCE) is None
    simulated.close()


def test_parameter_set_over_the_link_is_there_in_the_next_process(tmp_path: Path) -> None:
    path, values = tmp_path / "vehicle.memory", []
    for flight in (0, 1):
        host = Codec(*HOST)
        simulated = SimulatedVehicle.create(VEHICLE, flight=flight, memory=path)
        heard = bytearray()
        while simulated.now_us < 1_000_000:
            simulated.run_until(1_000_000)
            heard += simulated.serial_read()
            simulated.mocap_read()
            if simulated.now_us > 500_000 and not values:
                simulated.serial_write(host.encode(ParamSet(1, 1, b"POS_P_N", 4.25, 9)))
                values.append(4.25)
        if flight == 1:
            simulated.serial_write(host.encode(ParamRequestRead(1, 1, b"POS_P_N", -1)))
            while simulated.now_us < 1_500_000:
                simulated.run_until(1_500_000)
                heard += simulated.serial_read()
        answers = [a for a in host.decode(bytes(heard)) if isinstance(a, ParamValue)]
        assert answers[-1].param_value == 4.25
        simulated.close()
