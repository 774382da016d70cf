"""NanoBench files: frames, units, motor order, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.narrowing import not_none
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats.nanobench import COLUMNS, CORNERS, UNKNOWN, read


def test_nanobench_flight_is_told_in_ned_and_frd(nanobench_file: Callable[..., Path], made_up: Any) -> None:
    found = read(nanobench_file())
    np.testing.assert_array_equal(found.pose_us, np.round(1e6 * made_up.t))
    assert found.epoch_us == 1_772_660_536_000_000  # the file's times are Unix times
    np.testing.assert_allclose(found.p_ned, made_up.p, atol=1e-9)
    apart = (Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn).magnitude()
    assert apart.max() < 1e-9
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-9)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-8)
    np.testing.assert_allclose(not_none(found.motor_command), made_up.motor, atol=1e-9)
    np.testing.assert_allclose(not_none(found.battery_v), made_up.volt, atol=1e-9)
    assert found.motor_corners == CORNERS
    assert found.unknown == UNKNOWN
    assert found.thrust_n is None
    assert found.mass_kg is None


def test_nanobench_vehicle_at_rest_is_upright_and_feels_weight(
    nanobench_file: Callable[..., Path], foreign: SimpleNamespace
) -> None:
    found = read(nanobench_file())
    rest = found.pose_us < 900_000
    assert np.abs(not_none(found.specific_force)[rest] - [0.0, 0.0, -foreign.G]).max() < 0.2
    R = Rotation.from_quat(found.q_ned_frd[rest], scalar_first=True).as_matrix()
    assert R[:, 2, 2].min() > 0.999
    assert (found.p_ned[:, 2].min(), found.p_ned[:, 2].max()) == pytest.approx((-1.2, 0.0), abs=1e-3)


@pytest.mark.parametrize("gone", [("pz",), ("t", "imu_gyro_y"), ("motor_motor_m3", "pwr_pm_vbat", "qw")])
def test_nanobench_without_columns_names_all_of_them(
    nanobench_file: Callable[..., Path], gone: tuple[str, ...]
) -> None:
    with pytest.raises(ImportFormatError) as caught:
        read(nanobench_file(**dict.fromkeys(gone)))
    assert f"no column {', '.join(name for name in COLUMNS if name in gone)};" in str(caught.value)


@pytest.mark.parametrize("word", ["nan", "", "off", "inf"])
@pytest.mark.parametrize("column", ["t", "qx", "pwr_pm_vbat"])
def test_nanobench_row_without_a_number_is_skipped_and_counted(
    nanobench_file: Callable[..., Path], foreign: SimpleNamespace, made_up: Any, column: str, word: str
) -> None:
    cells = [f"{value:.17g}" for value in foreign.nanobench_columns(made_up)[column]]
    cells[40] = word
    found = read(nanobench_file(**{column: cells}))
    assert found.skipped_rows == 1
    assert len(not_none(found.imu_us)) == len(cells) - 1


def test_nanobench_rows_of_equal_time_count_once(
    nanobench_file: Callable[..., Path], foreign: SimpleNamespace, made_up: Any
) -> None:
    t = foreign.nanobench_columns(made_up)["t"]
    twice = t.copy()
    twice[[11, 31]] = t[[10, 30]]
    found = read(nanobench_file(t=twice))
    assert len(found.pose_us) == len(t) - 2
    assert len(not_none(found.motor_command)) == len(t) - 2
    np.testing.assert_allclose(found.p_ned[11], made_up.p[12], atol=1e-9)


def test_nanobench_time_that_runs_back_is_refused(
    nanobench_file: Callable[..., Path], foreign: SimpleNamespace, made_up: Any
) -> None:
    t = foreign.nanobench_columns(made_up)["t"].copy()
    t[100:] -= 0.5
    with pytest.raises(ImportFormatError, match="time decreases after row 99"):
        read(nanobench_file(t=t))


def test_nanobench_held_pose_is_no_measurement_but_its_inputs_are(
    nanobench_file: Callable[..., Path], foreign: SimpleNamespace, made_up: Any
) -> None:
    columns = foreign.nanobench_columns(made_up)
    held = {name: columns[name].copy() for name in ("px", "py", "pz", "qx", "qy", "qz", "qw")}
    for values in held.values():
        values[201:204] = values[200]
    found = read(nanobench_file(**held))
    assert len(found.pose_us) == len(made_up.t) - 3
    assert len(not_none(found.input_us)) == len(made_up.t)
    assert found.pose_us[201] - found.pose_us[200] == pytest.approx(40_000, abs=1)


def test_nanobench_quaternion_without_unit_norm_is_refused(
    nanobench_file: Callable[..., Path], foreign: SimpleNamespace, made_up: Any
) -> None:
    qw = foreign.nanobench_columns(made_up)["qw"].copy()
    qw[7] = 0.0
    with pytest.raises(ImportFormatError, match=r"quaternion of norm .* at row 7"):
        read(nanobench_file(qw=qw))
