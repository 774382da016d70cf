"""Groups of flights beside the worlds: what a file may say, and what becomes of it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from trimtab.host.vehicle import ConfigurationError
from trimtab.sitl.studies.files import StudyError, read_json
from trimtab.sitl.studies.recorded import judge_real, read_groups
from trimtab.sitl.studies.table import real_table

ROOT = Path(__file__).parents[3]
DATA = ROOT / "tests" / "data"
FLIGHTS = ROOT.parent / "shared" / "data"
OWN = '[[group]]\nname = "ours"\nlogs = ["a1.mcap", "a2.mcap", "b1.mcap"]\nhold_out = ["c1.mcap"]\n'


def written(folder: Path, text: str) -> Path:
    file = folder / "flights.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[[group]]\nname = "x"\nlogs = []\n', "logs"),
        ('[[group]]\nname = "x"\nlogs = ["a.csv"]\nformat = "csv"\n', "the format csv needs columns"),
        ('[[group]]\nname = "x"\nlogs = ["a"]\nformat = "nanobench"\n', "a format needs the vehicle"),
        (
            '[[group]]\nname = "x"\nlogs = ["b/a.mcap"]\nhold_out = ["c/b/a.mcap"]\n',
            "two logs have the same name and folder",
        ),
        ('[[group]]\nname = "x"\nlogs = ["a.mcap"]\nbaseline = ["a.mcap"]\n', "give each log once"),
        ('[[group]]\nname = "x"\nlogs = ["a.mcap"]\nexpected = [["mass"]]\n', "add label"),
        ('[[group]]\nname = "x"\nlogs = ["a.mcap"]\nholdout = ["b.mcap"]\n', "hold_out"),
        ("", "group"),
    ],
)
def test_file_that_says_something_wrong_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        read_groups(written(tmp_path, text))


def test_logs_of_one_name_are_called_after_their_folders(tmp_path: Path) -> None:
    for folder in ("cut", "normal"):
        (tmp_path / folder).mkdir()
        for number in (1, 2):
            (tmp_path / folder / f"log0{number}").touch()
    text = '[[group]]\nname = "x"\nlogs = ["cut/log01"]\nbaseline = ["normal/log01", "normal/log02"]\n'
    (group,) = read_groups(written(tmp_path, text))
    assert list(group.names.values()) == ["cut-log01", "normal-log01", "log02"]
    assert all(Path(path).is_absolute() for path in group.all_logs)


def test_log_that_is_not_there_is_refused_before_anything_is_traced(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"ours: .*a1\.mcap does not exist"):
        read_groups(written(tmp_path, OWN))
    with pytest.raises(StudyError, match=r"ours: .*before\.mcap does not exist"):
        read_groups(
            written(
                tmp_path, '[[group]]\nname = "ours"\nlogs = ["flights.toml"]\nbaseline = ["before.mcap"]\n'
            )
        )
    with pytest.raises(StudyError, match="cannot be read"):
        read_groups(tmp_path / "none.toml")


@pytest.mark.full  # a whole trace, twice
def test_own_flights_are_traced_once_and_again_when_a_log_has_changed(tmp_path: Path) -> None:
    for name in ("a1", "a2", "b1", "c1"):
        shutil.copy(DATA / f"{name}.mcap", tmp_path)
    groups = read_groups(written(tmp_path, OWN))
    (row,) = judge_real(groups, tmp_path / "state")
    assert row["held_out"] == ["c1"]
    assert {effect["name"] for effect in row["effects"]} <= {"thrust-gain", "motor-lag", "mocap-latency"}
    assert row["after_m"] < row["before_m"]
    file = tmp_path / "state" / "real" / "00" / "verdict.json"
    before = file.stat().st_mtime_ns
    assert judge_real(groups, tmp_path / "state") == [row]
    assert file.stat().st_mtime_ns == before
    (text,) = real_table([row])
    assert text["before"] == f"{1e3 * row['before_m']:.1f} mm"
    assert "thrust-gain gain" in text["said"]
    shutil.copy(DATA / "a2.mcap", tmp_path / "a1.mcap")
    (again,) = judge_real(groups, tmp_path / "state")
    assert again["verdict"] == "failed"
    assert "a2.mcap" in real_table([again])[0]["said"]
    assert read_json(file)["exit_code"] == 2


@pytest.mark.full  # beside the group above, and the imports' own tests
def test_group_of_the_documentation_is_imported_and_traced(
    tmp_path: Path, require: Callable[[str], None]
) -> None:
    require("flights")
    page = (ROOT / "docs" / "studies" / "studies.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    for name in ("nanobench", "crazyswarm2_tools"):
        (tmp_path / name).symlink_to(FLIGHTS / name)
    groups = read_groups(written(tmp_path, example))
    assert [group.format for group in groups] == ["nanobench", "crazyflie-usd"]
    (row,) = judge_real(groups[1:], tmp_path / "state")
    assert row["verdict"] == "undecided"
    assert row["after_m"] < 0.7 * row["before_m"]
    assert "5.8 s" in row["doubts"][0]
