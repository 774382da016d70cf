"""Calibration of the probabilities in verdicts, on answers whose right count is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from trimtab.host.effects import load_effects
from trimtab.sitl.studies import flights
from trimtab.sitl.studies.flights import BLIND, FEW, VERDICT
from trimtab.sitl.studies.scoring.probabilities import calibration, calibration_of, probability_rows
from trimtab.sitl.studies.scoring.world import judge_few
from trimtab.sitl.studies.table import false_certainties

EFFECTS = load_effects()


def answer(named: dict[str, float], possible: dict[str, float] | None = None) -> dict[str, Any]:
    return {
        "effects": [{"name": name, "probability": p} for name, p in named.items()],
        "possible": [{"name": name, "probability": p} for name, p in (possible or {}).items()],
    }


def rows(*pairs: tuple[float, bool]) -> list[dict[str, Any]]:
    return [{"name": "wind", "probability": p, "there": there} for p, there in pairs]


def test_named_and_possible_effects_are_compared_with_the_truth() -> None:
    said = answer({"motor-lag": 0.99}, {"wind": 0.2, "linear-drag": 0.1})
    assert probability_rows(said, ["motor-lag", "linear-drag"], EFFECTS) == [
        {"name": "wind", "probability": 0.2, "there": False},
        {"name": "linear-drag", "probability": 0.1, "there": True},
        {"name": "motor-lag", "probability": 0.99, "there": True},
    ]
    assert probability_rows({"error": "too short"}, ["wind"], EFFECTS) == []


def test_exact_aliases_are_one_effect_and_an_inertia_beside_them_is_not_judged() -> None:
    said = answer({"thrust-gain": 0.9, "inertia": 0.97}, {"mass": 0.95})
    assert probability_rows(said, ["mass"], EFFECTS) == [
        {"name": "thrust-over-mass", "probability": 0.95, "there": True}
    ]
    # An alias that is only possible excuses no named inertia.
    doubted = answer({"inertia": 0.97}, {"thrust-gain": 0.06})
    assert probability_rows(doubted, ["mass"], EFFECTS) == [
        {"name": "thrust-over-mass", "probability": 0.06, "there": True},
        {"name": "inertia", "probability": 0.97, "there": False},
    ]
    # Without the alias beside it, or if neither of the two is true, an inertia is judged.
    (alone,) = probability_rows(answer({"inertia": 0.97}), ["mass"], EFFECTS)
    assert (alone["name"], alone["there"]) == ("inertia", False)
    assert [row["there"] for row in probability_rows(said, ["inertia"], EFFECTS)] == [False, True]


def test_calibration_of_known_rows() -> None:
    found = calibration_of(rows((0.95, True), (1.0, False), (0.9499, False), (0.0, False), (0.25, True)))
    assert (found["n"], found["sure"], found["sure_n"]) == (5, 0.5, 2)
    # Clopper-Pearson of 1 in 2 in closed form: 0.025 = 1 - (1 - p)^2.
    assert found["sure_interval"] == pytest.approx([1 - 0.975**0.5, 0.975**0.5])
    assert found["brier"] == pytest.approx((0.05**2 + 1.0 + 0.9499**2 + 0.0 + 0.75**2) / 5)
    edges = [(b["low"], b["high"], b["n"], b["there"]) for b in found["bins"]]
    assert edges == [
        (0.0, 0.1, 1, 0.0),
        (0.1, 0.25, 1, 1.0),
        (0.9, 0.95, 1, 0.0),
        (0.95, 0.99, 1, 1.0),
        (0.999, 1.0, 1, 0.0),
    ]
    assert calibration_of([])["sure"] is None


@pytest.mark.parametrize("steps", [100, 1000])
def test_every_probability_is_in_one_bin(steps: int) -> None:
    found = calibration_of(rows(*((k / steps, True) for k in range(steps + 1))))
    assert sum(b["n"] for b in found["bins"]) == steps + 1


def few(names: dict[str, float], kinds: list[str]) -> dict[str, Any]:
    effects = [{"name": name, "probability": p, "aliases": [], "parameters": {}} for name, p in names.items()]
    said = {"verdict": "traced", "effects": effects}
    return judge_few(
        kinds, {"exit_code": 0, "answer": said, "errors": "", "trace_s": 5.0}, EFFECTS, frozenset()
    )


def test_calibration_keeps_the_kinds_of_data_apart_and_names_false_certainties() -> None:
    whole = {"class": "single", "verdict": "traced", "wrong": False, "probabilities": rows((0.99, True))}
    whole["few"] = {
        "one flight": few({"wind": 1.0}, ["motor-lag"]),
        "one pair": few({"motor-lag": 0.96}, ["motor-lag"]),
    }
    thin = {"class": "thin", "verdict": "undecided", "wrong": False, "probabilities": [], "few": {}}
    sure = rows((1.0, False))
    outside = {"class": "outside", "verdict": "traced", "wrong": True, "probabilities": sure, "few": {}}
    found = calibration([whole, thin, outside])
    assert {data: (c["worlds"], c["sure"], c["false_names"]) for data, c in found.items()} == {
        "one flight": (1, 0.0, 1.0),
        "one pair": (1, 1.0, 0.0),
        "full set": (1, 1.0, 0.0),
        "outside the library": (1, 0.0, 1.0),
        "thin data": (1, None, 0.0),
    }
    assert {data: (c["traced"], c["false_names_of_traced"]) for data, c in found.items()} == {
        "one flight": (1, 1.0),
        "one pair": (1, 0.0),
        "full set": (1, 0.0),
        "outside the library": (1, 1.0),
        "thin data": (0, None),
    }
    assert false_certainties(whole) == ["one flight: wind given 1.000, absent"]


def test_few_flights_are_the_first_flight_and_its_repeat_and_precede_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "flights").mkdir()
    for log, _, _ in BLIND.flights():
        (tmp_path / "flights" / f"{log}.mcap").write_bytes(b"")
    asked: list[tuple[list[str], list[str]]] = []

    def ask(folder: Path, logs: list[str], held_out: list[str]) -> dict[str, Any]:
        assert {path.name for path in folder.iterdir()} == {*logs, *held_out}
        assert not (tmp_path / VERDICT).exists()
        asked.append((logs, held_out))
        return {"logs": logs}

    monkeypatch.setattr(flights, "ask", ask)
    flights.trace(tmp_path, BLIND, few=True)
    assert asked[:2] == [(["quick-1.mcap"], []), (["quick-1.mcap", "quick-2.mcap"], [])]
    assert (len(asked[2][0]), len(asked[2][1])) == (8, 2)
    assert json.loads((tmp_path / FEW["one pair"]).read_text())["logs"] == ["quick-1.mcap", "quick-2.mcap"]
    flights.trace(tmp_path, BLIND, few=True)
    assert len(asked) == 3
