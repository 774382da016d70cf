"""What is kept of what was learned: the least error, of equals the simplest, and a line where it is less."""

from __future__ import annotations

import pytest

from trimtab.host.learn.candidates import Trial, best, note
from trimtab.host.learn.evaluate import Errors

WHATS = ("nothing", "effects", "effects and network")
NAN, INF = float("nan"), float("inf")


def trials(train_m: tuple[float, ...], test_m: tuple[float, ...] | None = None) -> list[Trial]:
    train, test = (
        [None if off is None else Errors(position_rmse_m=off, velocity_rmse_m_s=0.1) for off in each]
        for each in (train_m, test_m or (None, None, None))
    )
    return [Trial(what=w, train=a, test=b) for w, a, b in zip(WHATS, train, test, strict=True) if a]


@pytest.mark.parametrize(
    ("train_m", "test_m", "kept"),
    [
        ((0.03, 0.02, 0.01), None, "effects and network"),
        ((0.03, 0.01, 0.02), None, "effects"),
        ((0.01, 0.02, 0.03), None, "nothing"),
        ((0.02, 0.01, 0.01), None, "effects"),
        ((0.01, 0.01, 0.01), None, "nothing"),
        ((0.02, NAN, INF), None, "nothing"),
        ((NAN, 0.02, NAN), None, "effects"),
        # Learned by heart, by luck, and a little worse on those used than another on those held out.
        ((0.03, 0.02, 0.01), (0.03, 0.02, 0.025), "effects"),
        ((0.03, 0.04, 0.05), (0.03, 0.02, 0.01), "nothing"),
        ((0.03, 0.015, 0.018), (0.01, 0.008, 0.007), "effects and network"),
    ],
)
def test_best_is_the_simplest_whose_worse_ratio_is_least(train_m, test_m, kept):
    assert best(trials(train_m, test_m)).what == kept


def test_note_names_the_errors_where_less_is_better():
    tried = trials((0.0148, 0.0085, 0.0255))
    asked = "whole flights are predicted 25.5 mm off with effects and network, "
    assert note(tried, tried[1]) == [f"{asked}8.5 mm off with effects: effects kept"]
    assert note(tried, tried[-1]) == [f"{asked}8.5 mm off with effects, kept as asked"]
    (line,) = note(trials((0.01, 0.02, NAN), (0.012, 0.02, INF)), tried[0])
    assert "predicted inf mm (used) and inf mm (held out) off with effects and network" in line
    assert line.endswith("10.0 mm (used) and 12.0 mm (held out) off with nothing learned: nothing kept")


def test_note_is_none_where_what_was_asked_for_is_best():
    tried = trials((0.03, 0.02, 0.01))
    assert note(tried, tried[-1]) == []
