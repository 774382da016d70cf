"""sin, cos, exp, tanh and atan2 over lanes, against series in 60 decimal digits and outside their ranges."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest

from trimtab.host.codegen.compiler import Compiler
from trimtab.host.codegen.simd import aligned, lane_count, lanes_of, rows_of, simd_library

NAMES = ("sin", "cos", "exp", "tanh")
SPECIAL = np.array(
    [0.0, -0.0, 5e-324, 1023.9, 1024.1, -1e6, 1e300, 709.5, 710.0, -708.5, -800.0, np.inf, -np.inf, np.nan]
)
LARGEST_ERROR = 4
"""Units in the last place."""

Function = Callable[..., np.ndarray]


def functions(compiler: Compiler) -> dict[str, Function]:
    """Every function over arrays, compiled."""
    source = [
        f"void run_{name}(long n, const V *a, V *r) {{ for (long i = 0; i < n; ++i) r[i] = v{name}(a[i]); }}"
        for name in NAMES
    ]
    source.append(
        "void run_atan2(long n, const V *a, const V *b, V *r) "
        "{ for (long i = 0; i < n; ++i) r[i] = vatan2(a[i], b[i]); }"
    )
    library = simd_library("\n".join(source), compiler)
    lanes = lane_count(library)

    def call(name: str) -> Function:
        def run(*arguments: np.ndarray) -> np.ndarray:
            inputs = [lanes_of(part, lanes) for part in arguments]
            result = aligned(inputs[0].shape)
            addresses = [ctypes.c_void_p(part.ctypes.data) for part in (*inputs, result)]
            getattr(library, f"run_{name}")(ctypes.c_long(len(result)), *addresses)
            return rows_of(result, len(arguments[0]))

        return run

    return {name: call(name) for name in (*NAMES, "atan2")}


@pytest.fixture(scope="module")
def by_width(compiler_of_width) -> dict[int, dict[str, Function]]:
    return {width: functions(compiler_of_width(width)) for width in (2, 4, 8)}


def points() -> dict[str, list[np.ndarray]]:
    """Arguments of each function over its range, with those that a reduction finds hardest."""
    rng = np.random.default_rng(0)
    tiny = 10.0 ** rng.uniform(-300.0, 0.0, 50)
    quarters = np.pi / 2 * rng.integers(1, 651, 60)
    usual, far = rng.uniform(-1.6, 1.6, 300), rng.uniform(-1024.0, 1024.0, 300)
    angles = np.concatenate([usual, far, tiny, quarters, np.nextafter(quarters, 0.0)])
    halves = np.log(2.0) / 2 * (rng.integers(-1000, 1000, 100) + rng.uniform(-1e-3, 1e-3, 100))
    y, x = 10.0 ** rng.uniform(-3.0, 3.0, (2, 300)) * rng.choice([-1.0, 1.0], (2, 300))
    return {
        "sin": [angles],
        "cos": [angles],
        "exp": [np.concatenate([rng.uniform(-708.0, 709.0, 300), rng.uniform(-1.0, 1.0, 300), tiny, halves])],
        "tanh": [
            np.concatenate([rng.uniform(-25.0, 25.0, 200), rng.uniform(-1.5, 1.5, 500), tiny, halves / 20.0])
        ],
        "atan2": [y, x],
    }


def _sum(terms_of: Callable[[int], Decimal]) -> Decimal:
    total, n = Decimal(0), 0
    while True:
        term = terms_of(n)
        if total + term == total:
            return total
        total, n = total + term, n + 1


def _arctan(x: Decimal) -> Decimal:
    """Taylor's series after three halvings of the angle."""
    for _ in range(3):
        x = x / (1 + (1 + x * x).sqrt())
    return 8 * _sum(lambda n: (-1) ** n * x ** (2 * n + 1) / (2 * n + 1))


def _sine(x: Decimal, quarter_turns: int = 0) -> Decimal:
    quarter = 2 * _arctan(Decimal(1))
    x = (x + quarter_turns * quarter) % (4 * quarter)
    return _sum(lambda n: (-1) ** n * x ** (2 * n + 1) / math.factorial(2 * n + 1))


def _tanh(x: Decimal) -> Decimal:
    if abs(x) >= 1:
        return 1 - 2 / ((2 * x).exp() + 1)
    above = _sum(lambda n: (2 * x) ** (n + 1) / math.factorial(n + 1))
    return above / (above + 2)


def _atan2(y: Decimal, x: Decimal) -> Decimal:
    half_turn = 4 * _arctan(Decimal(1))
    return _arctan(y / x) + (0 if x > 0 else half_turn.copy_sign(y))


EXACT = {"sin": _sine, "cos": lambda x: _sine(x, 1), "exp": Decimal.exp, "tanh": _tanh, "atan2": _atan2}


@pytest.mark.parametrize("name", [*NAMES, "atan2"])
def test_functions_over_lanes_are_exact_to_4_units_in_the_last_place(by_width, name):
    arguments = points()[name]
    values = by_width[8][name](*arguments)
    with localcontext(prec=60):
        for value, *at in zip(values, *arguments, strict=True):
            exact = EXACT[name](*map(Decimal, at))
            error = abs(Decimal(value) - exact) / Decimal(float(np.spacing(abs(value))))
            assert error <= LARGEST_ERROR, at


@pytest.mark.parametrize("name", [*NAMES, "atan2"])
def test_functions_over_lanes_have_the_same_bits_for_any_number_of_lanes(by_width, name):
    arguments = [np.concatenate([part, SPECIAL]) for part in points()[name]]
    first, *others = (by_width[width][name](*arguments).tobytes() for width in (2, 4, 8))
    assert others == [first, first]


@pytest.mark.parametrize("name", NAMES)
def test_special_arguments_have_libms_value_and_leave_their_neighbours_alone(by_width, name):
    usual = np.linspace(-1.0, 1.0, len(SPECIAL))
    mixed = np.stack([usual, SPECIAL], axis=1).ravel()
    values = by_width[8][name](mixed)
    np.testing.assert_array_equal(values[::2], by_width[8][name](usual))
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(SPECIAL)
    np.testing.assert_array_max_ulp(values[1::2], expected, LARGEST_ERROR)
    np.testing.assert_array_equal(np.signbit(values[1::2]), np.signbit(expected))


def test_atan2_of_special_arguments_has_libms_value(by_width):
    y, x = (part.ravel() for part in np.meshgrid(SPECIAL, SPECIAL))
    values, expected = by_width[8]["atan2"](y, x), np.arctan2(y, x)
    np.testing.assert_array_max_ulp(values, expected, LARGEST_ERROR)
    np.testing.assert_array_equal(np.signbit(values), np.signbit(expected))
