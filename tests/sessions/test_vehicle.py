"""`trimtab vehicle`: files that are planned, flown and checked at once; exit codes; bad input in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.log import read_flight

MADE = Path(__file__).parents[1] / "data"
Run = Callable[..., tuple[int, dict[str, Any], str]]
FACTS = ("--mass-kg", "0.75", "--arm-m", "0.125", "--propeller", "5x4.3")
CASES = {
    "nano27": ("--mass-kg", "0.027", "--arm-m", "0.046", "--propeller", "1.8x1.2"),
    "small": ("--mass-kg", "0.25", "--arm-m", "0.075", "--propeller", "3x3", "--kv", "4000"),
    "middle": (*FACTS, "--kv", "2400", "--cells", "4"),
    "large": ("--mass-kg", "2.5", "--arm-m", "0.3", "--propeller", "13x4.4"),
}


@pytest.mark.parametrize("name", CASES)
def test_new_file_is_planned_flown_and_checked_at_once(name: str, run_trimtab: Run) -> None:
    told = run_trimtab("vehicle", "new", name, *CASES[name], "--json")[1]
    assert "inertia_kg_m2" in told["guessed"]
    assert told["file"].endswith(f"vehicles/{name}.toml")
    assert run_trimtab("plan", "figure-eight", "--vehicle", name)[0] == 0
    fly = ("fly", "figure-eight.ref", "--vehicle", name, "--world-seed", "4", "-o", "first.mcap")
    assert run_trimtab(*fly)[0] == 0
    flight = read_flight("first.mcap")
    assert flight.failsafe is None
    assert flight.tracking_whole
    code, checked, _ = run_trimtab("vehicle", "check", "first.mcap", "--json")
    assert code == 0
    assert checked["fits"]
    assert checked["order"] == [1, 2, 3, 4]
    assert (checked["order_verdict"], checked["spins_verdict"]) == ("fits", "fits")


@pytest.mark.full
@pytest.mark.parametrize("name", CASES)
def test_flights_of_a_new_file_are_traced(name: str, run_trimtab: Run) -> None:
    assert run_trimtab("vehicle", "new", name, *CASES[name])[0] == 0
    assert run_trimtab("plan", "figure-eight", "--vehicle", name)[0] == 0
    logs = ["0.mcap", "1.mcap"]
    for index, log in enumerate(logs):
        fly = ("fly", "figure-eight.ref", "--vehicle", name, "--flight", str(index), "-o", log)
        assert run_trimtab(*fly)[0] == 0
    code, told, _ = run_trimtab("trace", *logs, "--no-network", "--json")
    assert code == 0
    assert told["verdict"] == "nothing-missing"


@pytest.mark.full
def test_no_flight_without_an_effect_is_called_a_misfit(run_trimtab: Run) -> None:
    for name in ("research", "nano"):
        assert run_trimtab("plan", "low-high", "--vehicle", name, "-o", f"{name}.ref")[0] == 0
        for seed in map(str, range(4)):
            fly = ("fly", f"{name}.ref", "--vehicle", name, "--world-seed", seed, "--force", "-o", "x.mcap")
            assert run_trimtab(*fly)[0] == 0
            code, told, _ = run_trimtab("vehicle", "check", "x.mcap", "--json")
            assert (code, told["differing"]) == (0, [])


def test_file_that_does_not_fit_prints_all_and_exits_with_one(run_trimtab: Run, tmp_path: Path) -> None:
    log = str(MADE / "b1.mcap")
    text = read_flight(log).vehicle.to_toml().replace('name = "research"', 'name = "heavy"')
    (tmp_path / "heavy.toml").write_text(text.replace("mass_kg = 0.752", "mass_kg = 0.9"))
    code, told, complaint = run_trimtab("vehicle", "check", log, "--vehicle", "heavy.toml", "--json")
    assert code == 1
    assert told["differing"] == ["mass", "thrust"]
    assert told["vehicle"] == "heavy"
    assert len(complaint.splitlines()) == 1


def test_parameter_file_gives_order_spins_and_pulses(run_trimtab: Run, tmp_path: Path) -> None:
    rows = {
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 12,
        "MOT_THST_HOVER": 0.2,
        "MOT_PWM_MIN": 1000,
        "MOT_PWM_MAX": 2000,
        "MOT_SPIN_MIN": 0.1,
        "MOT_SPIN_MAX": 0.95,
    }
    (tmp_path / "quad.param").write_text("".join(f"{name},{value}\n" for name, value in rows.items()))
    words = ("vehicle", "new", "mine", *FACTS, "--parameters", "quad.param")
    told = run_trimtab(*words, "--json")[1]
    assert "thrust_max_n" not in told["guessed"]
    text = (tmp_path / "vehicles" / "mine.toml").read_text()
    assert "1100 and 1950 us" in text
    assert text.index("rear right") < text.index("front right") < text.index("rear left")
    assert run_trimtab(*words)[0] == 2  # it exists
    assert run_trimtab(*words, "--force")[0] == 0


@pytest.mark.parametrize(
    "words",
    [
        ("mine", "--mass-kg", "0.75", "--propeller", "5x4.3"),
        ("mine", "--mass-kg", "750", "--arm-m", "0.125", "--propeller", "5x4.3"),
        ("mine", "--mass-kg", "nan", "--arm-m", "0.125", "--propeller", "5x4.3"),
        ("mine", "--mass-kg", "0.75", "--arm-m", "0.125", "--propeller", "large"),
        ("mine", "--mass-kg", "0.75", "--arm-m", "0.04", "--propeller", "5x4.3"),
        ("mine", *FACTS, "--kv", "-1"),
        ("mine", *FACTS, "--cells", "0"),
        ("mine", *FACTS, "--parameters", "missing.param"),
        ("mine", *FACTS, "--parameters", "hexa.param"),
        ("mine", *FACTS, "-o", "mine.txt"),
        ("../mine", *FACTS),
        ("mine",),
    ],
)
def test_bad_facts_are_refused_in_one_line_and_nothing_is_written(
    words: tuple[str, ...], run_trimtab: Run, tmp_path: Path
) -> None:
    (tmp_path / "hexa.param").write_text("FRAME_CLASS,2\nFRAME_TYPE,1\n")
    code, told, complaint = run_trimtab("vehicle", "new", *words, "--json")
    assert code == 2
    assert told["exit_code"] == 2
    assert len(complaint.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["hexa.param"]


def test_check_of_what_is_no_log_says_so(run_trimtab: Run, tmp_path: Path) -> None:
    assert run_trimtab("vehicle", "check", "missing.mcap")[0] == 2
    (tmp_path / "x.mcap").write_bytes(b"no log")
    assert run_trimtab("vehicle", "check", "x.mcap")[0] == 5
    assert run_trimtab("vehicle", "check", str(MADE / "b1.mcap"), "--vehicle", "nobody")[0] == 2
