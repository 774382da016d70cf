"""Shapes in annotations are true of real runs; what checks them finds one that is not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Annotated, Optional

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.shapes import ShapeError, check, check_all, shape_of, shapes_of

ROOT = Path(__file__).parents[1]
DATA = ROOT / "tests" / "data"
A1, B1, C1 = (str(DATA / f"{name}.mcap") for name in ("a1", "b1", "c1"))


@pytest.mark.parametrize(
    ("shape", "actual", "fits"),
    [
        ("3", (3,), True),
        ("3", (4,), False),
        ("3", (3, 1), False),
        ("rows 3", (7, 3), True),
        ("rows rows", (7, 7), True),
        ("rows rows", (7, 6), False),
        ("_ 3", (9, 3), True),
        ("... 3", (3,), True),
        ("... 3", (5, 4, 3), True),
        ("... 3", (5, 4), False),
        ("... rows 3", (3,), False),
    ],
)
def test_array_is_compared_with_its_shape(shape: str, actual: tuple[int, ...], fits: bool) -> None:
    if fits:
        check(np.zeros(actual), shape, {}, "x")
    else:
        with pytest.raises(ShapeError, match="x has shape"):
            check(np.zeros(actual), shape, {}, "x")


def test_name_is_one_length_among_several_arrays() -> None:
    lengths: dict[str, int] = {}
    check(np.zeros((2, 3)), "rows 3", lengths, "x")
    with pytest.raises(ShapeError, match="y has shape"):
        check(np.zeros(4), "rows", lengths, "y")


def test_shape_is_read_from_an_annotation() -> None:
    assert shape_of(Annotated[np.ndarray, "rows 3"]) == "rows 3"
    assert shape_of(Optional[Annotated[np.ndarray, "3"]]) == "3"  # noqa: UP045  as a string evaluates
    assert shape_of(Annotated[NDArray[np.int64], "rows"]) == "rows"
    assert shape_of(np.ndarray) is None
    assert shape_of(Annotated[float, "m"]) is None


def test_arrays_of_a_tuple_are_compared() -> None:
    shapes = shapes_of(
        tuple[float, Annotated[np.ndarray, "rows 3"], tuple[Annotated[np.ndarray, "rows"], int]]
    )
    assert shapes == (None, "rows 3", ("rows", None))
    check_all((0.0, np.zeros((2, 3)), (np.zeros(2), 1)), shapes, {}, "x")
    with pytest.raises(ShapeError, match=r"x\[2\]\[0\] has shape"):
        check_all((0.0, np.zeros((2, 3)), (np.zeros(3), 1)), shapes, {}, "x")


def test_tuple_without_shapes_has_none() -> None:
    assert shapes_of(tuple[float, np.ndarray]) is None
    assert shapes_of(tuple[Annotated[np.ndarray, "3"], ...]) is None


@pytest.mark.full  # each runs a verb with every array checked
@pytest.mark.parametrize(
    "words",
    [
        pytest.param(f"trace {A1} {B1} --hold-out {C1} -o traced", id="trace"),
        pytest.param(f"learn {A1} {B1} --hold-out {C1} -o learned.model.toml", id="learn"),
        pytest.param("plan figure-eight --kind min-control", id="plan"),
    ],
)
def test_arrays_of_a_verb_have_the_shapes_of_their_annotations(words: str, tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "tests" / "shapes.py"), *words.split()]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stderr.splitlines()[-1].split()[0]) > 100
