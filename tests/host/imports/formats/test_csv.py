"""CSV files by column map: every frame and unit, and every problem of a map at once."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.narrowing import not_none
from trimtab.host.imports import ImportFormatError
from trimtab.host.imports.formats.csv import contents, read, read_map
from trimtab.host.vehicle import ConfigurationError

LEAST = """
world = "nwu"
body = "flu"
time = "t"
position_m = ["x", "y", "z"]
quaternion = ["qw", "qx", "qy", "qz"]
"""


def map_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "map.toml"
    path.write_text(text)
    return path


def three(name: str) -> str:
    return f'["{name}x", "{name}y", "{name}z"]'


def in_columns(flight: Any, **more: np.ndarray) -> dict[str, np.ndarray]:
    """A flight's arrays as single columns."""
    q, rpy = flight.turn.as_quat(), flight.turn.as_euler("ZYX")[:, ::-1]
    columns = {"t": flight.t}
    columns |= {f"p{axis}": flight.p[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"q{axis}": q[:, i] for i, axis in enumerate("xyzw")}
    columns |= {f"rpy{axis}": rpy[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"w{axis}": flight.gyro[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"f{axis}": flight.force[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"m{i}": flight.motor[:, i] for i in range(4)}
    return columns | {"T": flight.thrust, "u": flight.volt} | more


@pytest.mark.parametrize("world", ["ned", "nwu", "enu"])
@pytest.mark.parametrize("body", ["frd", "flu"])
@pytest.mark.parametrize("attitude", ["xyzw", "wxyz", "rad", "deg"])
def test_csv_of_any_axes_is_told_in_ned_and_frd(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any, world: str, body: str, attitude: str
) -> None:
    columns = in_columns(foreign.in_axes(made_up, world, body))
    if attitude == "deg":
        columns |= {name: np.rad2deg(columns[name]) for name in ("rpyx", "rpyy", "rpyz")}
    path = foreign.write_csv(tmp_path / "f.csv", columns)
    if attitude in ("rad", "deg"):
        how = f'euler = {three("rpy")}\neuler_unit = "{attitude}"\n'
    else:
        names = ", ".join(f'"q{axis}"' for axis in attitude)
        how = f'quaternion = [{names}]\nquaternion_order = "{attitude}"\n'
    text = f'world = "{world}"\nbody = "{body}"\ntime = "t"\nposition_m = {three("p")}\n{how}'
    text += f"gyro = {three('w')}\nspecific_force = {three('f')}\n"
    found = read(path, map_file(tmp_path, text))
    np.testing.assert_allclose(found.p_ned, made_up.p, atol=1e-9)
    apart = (Rotation.from_quat(found.q_ned_frd, scalar_first=True).inv() * made_up.turn).magnitude()
    assert apart.max() < 1e-9
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-9)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-9)
    assert found.input_us is None
    assert found.battery_v is None


@pytest.mark.parametrize(("unit", "scale"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
def test_csv_units_are_converted(
    tmp_path: Path, foreign: SimpleNamespace, made_up: Any, unit: str, scale: float
) -> None:
    f = foreign.in_axes(made_up, "nwu", "flu")
    columns = in_columns(
        f,
        t=f.t * scale + 77.0,
        **{f"w{axis}": np.rad2deg(f.gyro[:, i]) for i, axis in enumerate("xyz")},
        **{f"f{axis}": f.force[:, i] / foreign.G for i, axis in enumerate("xyz")},
        **{f"m{i}": 1000.0 * f.motor[:, i] for i in range(4)},
    )
    text = LEAST.replace('"x", "y", "z"', '"px", "py", "pz"') + (
        f'time_unit = "{unit}"\ngyro = {three("w")}\ngyro_unit = "deg/s"\nspecific_force = {three("f")}\n'
        'specific_force_unit = "g"\nmotor_command = ["m0", "m1", "m2", "m3"]\nmotor_command_full = 1000\n'
        f'battery_v = "u"\nreference_position_m = {three("p")}\nreference_velocity_m_s = {three("w")}\n'
        f'reference_acceleration_m_s2 = {three("f")}\nunknown = ["motor-lag", "thrust-curve"]\n'
    )
    found = read(foreign.write_csv(tmp_path / "f.csv", columns), map_file(tmp_path, text))
    np.testing.assert_array_equal(found.pose_us, np.round(1e6 * made_up.t))
    assert found.epoch_us == round(77.0 * 1e6 / scale)
    np.testing.assert_allclose(not_none(found.gyro), made_up.gyro, atol=1e-9)
    np.testing.assert_allclose(not_none(found.specific_force), made_up.force, atol=1e-8)
    np.testing.assert_allclose(not_none(found.motor_command), made_up.motor, atol=1e-9)
    assert found.motor_corners is None
    np.testing.assert_allclose(not_none(found.battery_v), made_up.volt, atol=1e-9)
    np.testing.assert_allclose(not_none(found.p_ref_ned), made_up.p, atol=1e-9)
    assert not_none(found.v_ref_ned).shape == not_none(found.a_ref_ned).shape == (len(made_up.t), 3)
    assert found.unknown == ("motor-lag", "thrust-curve")


def test_csv_thrust_without_torque_leaves_the_torque_unknown(tmp_path: Path) -> None:
    found = read_map(map_file(tmp_path, LEAST + 'thrust_n = "T"\n'))
    assert found.unknown == ("torque",)
    whole = LEAST + f'thrust_n = "T"\ntorque_n_m = {three("m")}\n'
    assert read_map(map_file(tmp_path, whole)).unknown == ()


def test_map_with_many_problems_tells_them_all(tmp_path: Path) -> None:
    text = """
world = "xyz"
body = "frd"
position_m = ["x", "x", "z"]
quaternion = ["a", "b", "c"]
euler = ["r", "p", "y"]
motor_comand = ["1", "2", "3", "4"]
motor_command_full = 0
torque_n_m = ["1", "2", "3"]
gyro_unit = "deg/s"
unknown = ["weather"]
"""
    with pytest.raises(ConfigurationError) as caught:
        read_map(map_file(tmp_path, text))
    problems = caught.value.problems
    for start in (
        "map.toml: world: 'xyz' is not possible",
        "map.toml: time: missing",
        "map.toml: quaternion",
        "map.toml: motor_comand: unknown key; did you mean motor_command?",
        "map.toml: motor_command_full: 0 is out of range",
        "map.toml: motor_command_full: has no meaning without motor_command",
        "map.toml: unknown[0]: 'weather' is not possible",
        "map.toml: attitude: give either quaternion or euler",
        "map.toml: torque_n_m: has no meaning without thrust_n",
        "map.toml: gyro_unit: has no meaning without gyro",
        "map.toml: position_m: names a column twice",
    ):
        assert sum(problem.startswith(start) for problem in problems) == 1, start
    assert len(problems) == 11
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            'motor_command = ["1", "2", "3", "4"]\nthrust_n = "T"\ngyro = ["a", "b", "c"]\n',
            "give either motor_",
        ),
        ("euler = 3\n", "attitude: give either"),
    ],
)
def test_map_that_contradicts_itself_is_refused(tmp_path: Path, more: str, said: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        read_map(map_file(tmp_path, LEAST + more))
    assert said in str(caught.value)


@pytest.mark.parametrize("content", [b"world = \n", b"\xff\xfe"])
def test_map_that_is_no_toml_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "map.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"map\.toml"):
        read_map(path)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_map(tmp_path / "absent.toml")


def test_csv_with_bad_rows_is_refused(tmp_path: Path, foreign: SimpleNamespace, made_up: Any) -> None:
    text = LEAST.replace('"x", "y", "z"', '"px", "py", "pz"')
    columns = in_columns(made_up)
    chosen = map_file(tmp_path, text)
    back = columns["t"].copy()
    back[50:] -= 1.0
    with pytest.raises(ImportFormatError, match="decreases after row 49"):
        read(foreign.write_csv(tmp_path / "f.csv", columns | {"t": back}), chosen)
    wrong = columns | {"qw": 2.0 * columns["qw"]}
    with pytest.raises(ImportFormatError, match="quaternion of norm"):
        read(foreign.write_csv(tmp_path / "f.csv", wrong), chosen)
    with pytest.raises(ImportFormatError, match="no column px, py, pz, qw"):
        read(foreign.write_csv(tmp_path / "f.csv", {"t": back, "qx": back, "qy": back, "qz": back}), chosen)


def test_contents_of_a_table_with_words_are_told(tmp_path: Path) -> None:
    path = tmp_path / "flight.csv"
    path.write_text("day,x,y\nmonday,1,2\n\ntuesday,3,4\n")
    assert [(topic.name, topic.count) for topic in contents(path).topics] == [("day", 2), ("x", 2), ("y", 2)]


def test_contents_of_a_missing_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ImportFormatError, match="cannot be read"):
        contents(tmp_path / "none.csv")
