"""Foreign plants: flown where they are sound, named where they are not."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

import pytest

from trimtab.host.base.trust import UntrustedError
from trimtab.host.vehicle import load_vehicle
from trimtab.sitl.foreign import ForeignPlant, ForeignPlantError, load_foreign_plant, read_plant_options

FILE = Path(__file__).parent.parent / "plants" / "thermal.py"
LEVEL = (1.0, 0.0, 0.0, 0.0)


def thermal(**options: object) -> ForeignPlant:
    plant = load_foreign_plant(f"{FILE}:Thermal", load_vehicle("research"), options, 1)
    plant.reset((1.0, 2.0, 0.0), LEVEL)
    return plant


def test_sound_plant_steps_and_shows_its_state() -> None:
    plant = thermal()
    for _ in range(200):
        plant.step((0.0, 0.0, 0.0, 0.0))
    assert plant.pose.tolist() == [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, *LEVEL]
    assert plant.sensed.tolist() == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, -9.81, 16.8])
    for _ in range(500):
        plant.step((0.6, 0.6, 0.6, 0.6))
    assert plant.pose[2] < -0.1


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (
            {"fail_after_ticks": 5},
            "thermal.py:Thermal: step raised ArithmeticError: the column has collapsed",
        ),
        ({"nan_after_ticks": 5}, "thermal.py:Thermal: v_ned is .*nan.*, not finite"),
    ],
)
def test_plant_that_fails_in_flight_is_named(options: dict[str, object], told: str) -> None:
    plant = thermal(**options)
    for _ in range(5):
        plant.step((0.1, 0.1, 0.1, 0.1))
    with pytest.raises(ForeignPlantError, match=told) as caught:
        plant.step((0.1, 0.1, 0.1, 0.1))
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("stop", [SystemExit(3), GeneratorExit(), RuntimeError("no air")])
@pytest.mark.parametrize("method", ["reset", "step", "state"])
def test_plant_that_stops_the_program_is_named(
    monkeypatch: pytest.MonkeyPatch, method: str, stop: BaseException
) -> None:
    plant = thermal()

    def stopping(*arguments: object) -> None:
        raise stop

    monkeypatch.setattr(plant._body, method, stopping)
    with pytest.raises(ForeignPlantError, match=rf"Thermal: {method} raised {type(stop).__name__}"):
        plant.step((0.1,) * 4) if method != "reset" else plant.reset((0.0, 0.0, 0.0), LEVEL)


def test_ctrl_c_in_a_plant_stays_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = thermal()

    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(plant._body, "step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        plant.step((0.1,) * 4)


def test_plant_whose_numbers_are_too_large_to_read_is_named() -> None:
    plant = thermal()
    plant._body.p = [10**400, 0, 0]
    with pytest.raises(ForeignPlantError, match="state must be"):
        plant._take()


@pytest.mark.parametrize("text", ["import sys\nsys.exit(3)", "class Plant:\n    def __init__(*a): exit(3)"])
def test_file_that_stops_the_program_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "stops.py"
    path.write_text(text + "\n")
    with pytest.raises(ForeignPlantError, match=r"stops\.py:Plant: cannot be built, SystemExit: 3"):
        load_foreign_plant(f"{path}:Plant", load_vehicle("research"), {}, 1)


def test_plant_with_a_malformed_state_is_told_what_it_must_hold() -> None:
    with pytest.raises(ForeignPlantError, match="state must be p_ned, v_ned, q_ned_frd"):
        thermal(malformed=True)


def test_plant_with_a_quaternion_that_is_no_rotation_is_refused() -> None:
    plant = thermal()
    plant._body.q = [1.0, 0.5, 0.0, 0.0]
    with pytest.raises(ForeignPlantError, match=r"q_ned_frd has length 1\.118"):
        plant._take()


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ("thermal.py", "give it as path.py:Class"),
        ("/nowhere/plant.py:Plant", "no such file"),
        (f"{FILE}:Nobody", "cannot be built, AttributeError"),
        (f"{FILE}:Broken", "cannot be built, RuntimeError: no air in this room"),
        (f"{FILE}:Stub", "has no step, state"),
    ],
)
def test_plant_that_cannot_be_loaded_is_refused_with_the_reason(spec: str, told: str) -> None:
    with pytest.raises(ForeignPlantError, match=told):
        load_foreign_plant(spec, load_vehicle("research"), {}, 1)


def test_plant_options_are_read_and_bad_ones_named(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.toml", tmp_path / "bad.toml"
    good.write_text("strength_m_s2 = 1.5\n")
    bad.write_text("strength = \n")
    assert read_plant_options(good) == {"strength_m_s2": 1.5}
    assert read_plant_options(None) == {}
    for path in (bad, tmp_path / "missing.toml"):
        with pytest.raises(ForeignPlantError, match=path.name):
            read_plant_options(path)


def test_plants_attitude_convention_is_the_simulators() -> None:
    """Rolled to the right, a hovering vehicle is pushed to the right: positive east at yaw 0."""
    plant = thermal()
    plant.reset((0.0, 0.0, -5.0), (math.cos(0.1), math.sin(0.1), 0.0, 0.0))
    for _ in range(300):
        plant.step((0.46, 0.46, 0.46, 0.46))
    assert plant.pose[4] > 0.05


_PLANT = """
class P:
    value = 1
    def __init__(self, vehicle, options, seed): pass
    reset = step = state = lambda self, *_: None
"""


def test_plant_of_the_users_is_named_before_it_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "own.py"
    path.write_text("print('ran')" + _PLANT)
    for _ in range(2):
        load_foreign_plant(f"{path}:P", load_vehicle("research"), {}, 1)
    assert capsys.readouterr().err == f"trimtab: runs the code in {path}\n"


def test_plant_that_others_can_change_runs_only_if_trusted(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(_PLANT)
    path.chmod(0o666)
    with pytest.raises(UntrustedError, match=r"own\.py: not run, everybody can write to .*--trust"):
        load_foreign_plant(f"{path}:P", load_vehicle("research"), {}, 1)
    load_foreign_plant(f"{path}:P", load_vehicle("research"), {}, 1, trusted=True)


def test_plant_does_not_run_from_bytecode_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib.util
    import py_compile

    path = tmp_path / "own.py"
    path.write_text(_PLANT.replace("value = 1", "value = 2"))
    status = path.stat()
    py_compile.compile(str(path), cfile=importlib.util.cache_from_source(str(path)))
    path.write_text(_PLANT)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    load_foreign_plant(f"{path}:P", load_vehicle("research"), {}, 1)
    assert sys.modules["trimtab_plant_own"].P.value == 1
