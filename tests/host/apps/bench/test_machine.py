"""What a machine can do at best."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from trimtab.host.apps.bench import machine


def test_peak_is_that_of_a_vector_unit(require: Callable[[str], None]) -> None:
    require("compiler")
    found = machine.measure()
    assert found["lanes"] in (2, 4, 8)
    assert found["peak_gflops"] > 0.5 * found["lanes"]


def test_without_a_compiler_there_is_no_peak_and_no_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRIMTAB_ENGINE", "vm")
    found = machine.measure()
    assert found["lanes"] is None
    assert machine.gradient_floor_ms(found["peak_gflops"], 1000, 10) is None


def test_floors_are_operations_over_the_peak() -> None:
    assert machine.gradient_floor_ms(6.0, 1000, 1000) == pytest.approx(1.0)
    assert machine.recursion_floor_ms(2.0, 10, 10, 1000) == pytest.approx(6.0)
