"""Parameters of an effect: neutral value, typical size, bounds, tolerance and unit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TypedDict, Unpack

DISCREPANCY = 0.05
"""Default of `Parameter.discrepancy`."""
LOOP_DISCREPANCY = 0.01
"""Default of `Parameter.loop_discrepancy`."""
_KEY = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of an effect.

    Attributes
    ----------
    key, unit, description
        Name in `lower_snake_case`, unit ("1" for none) and meaning.
    neutral
        Value that changes nothing.
    typical
        Usual distance from neutral if the effect is present. It scales the parameter in every fit.
    tolerance
        One standard deviation of a value that is not worth naming. A vehicle file may override it.
    lower, upper
        Bounds of the value.
    strength
        False for a parameter that changes nothing by itself, such as the length of a line without a payload.
    discrepancy
        One standard deviation, in typical sizes, of the value that segments show if the effect is absent,
        since no model is exact.
    loop_discrepancy
        The same for whole flights in closed loop.
    free_sigma
        One standard deviation of the value if a log frees the effect (`Effect.freed_by`); `typical` if None.
    free_lower, free_upper
        Bounds of the value in that case; `lower` and `upper` if None. A parameter that may be negative only
        in that case has a negative `free_lower`.
    measured_below
        Tolerance below which the value counts as measured, so that the effect is no exact alias of another
        one. None if the value cannot be measured.
    form
        True for a parameter of the effect's form: how a real vehicle may deviate from the equation. It
        changes nothing while the effect is neutral. Its tolerance is then its prior standard deviation, so a
        smaller effect that explains only such a deviation is not named (Kennedy and O'Hagan 2001, "Bayesian
        calibration of computer models").

    All numbers except the two discrepancies are in the unit of the parameter.
    """

    key: str
    unit: str
    neutral: float
    typical: float
    tolerance: float
    lower: float
    upper: float
    description: str
    strength: bool = True
    discrepancy: float = DISCREPANCY
    loop_discrepancy: float = LOOP_DISCREPANCY
    free_sigma: float | None = None
    free_lower: float | None = None
    free_upper: float | None = None
    measured_below: float | None = None
    form: bool = False

    def __post_init__(self) -> None:
        if not _KEY.fullmatch(self.key):
            raise ValueError(f"parameter key {self.key!r} is not lower_snake_case")
        numbers = (self.neutral, self.typical, self.tolerance, self.lower, self.upper)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"parameter {self.key}: every number must be finite, got {numbers}")
        if not self.lower <= self.neutral <= self.upper:
            raise ValueError(
                f"parameter {self.key}: neutral {self.neutral} outside [{self.lower}, {self.upper}]"
            )
        if not 0.0 < self.tolerance < self.typical and not self.form:
            raise ValueError(
                f"parameter {self.key}: need 0 < tolerance < typical, got {self.tolerance}, {self.typical}"
            )
        for name in ("discrepancy", "loop_discrepancy"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(
                    f"parameter {self.key}: {name} must be finite and >= 0, got {getattr(self, name)}"
                )
        for name in ("free_sigma", "measured_below"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise ValueError(f"parameter {self.key}: {name} must be finite and > 0, got {value}")
        lower, upper = self.free_bounds
        if not -math.inf < lower <= self.neutral <= upper < math.inf:
            raise ValueError(
                f"parameter {self.key}: neutral {self.neutral} outside free_lower {lower}, free_upper {upper}"
            )

    @property
    def free_bounds(self) -> tuple[float, float]:
        """Bounds of the value if a log frees the effect."""
        return (
            self.lower if self.free_lower is None else self.free_lower,
            self.upper if self.free_upper is None else self.free_upper,
        )

    @property
    def has_free_facts(self) -> bool:
        """Whether any of `free_sigma`, `free_lower` and `free_upper` is given."""
        return any(fact is not None for fact in (self.free_sigma, self.free_lower, self.free_upper))


def form(
    key: str,
    sd: float,
    lower: float,
    upper: float,
    description: str,
    *,
    unit: str = "1",
    neutral: float = 0.0,
) -> Parameter:
    """Return a parameter of an effect's form (`Parameter.form`) with the prior standard deviation `sd`."""
    return Parameter(
        key=key,
        unit=unit,
        neutral=neutral,
        typical=sd,
        tolerance=sd,
        lower=lower,
        upper=upper,
        description=description,
        strength=False,
        discrepancy=0.0,
        loop_discrepancy=0.0,
        form=True,
    )


class NumberOptions(TypedDict, total=False):
    """Optional fields of `Parameter`."""

    strength: bool
    discrepancy: float
    loop_discrepancy: float
    free_sigma: float | None
    free_lower: float | None
    free_upper: float | None
    measured_below: float | None


def number(
    key: str,
    unit: str,
    neutral: float,
    typical: float,
    tolerance: float,
    lower: float,
    upper: float,
    description: str,
    **options: Unpack[NumberOptions],
) -> Parameter:
    """Return a `Parameter` from positional arguments, for short effect files in a workspace."""
    return Parameter(
        key=key,
        unit=unit,
        neutral=neutral,
        typical=typical,
        tolerance=tolerance,
        lower=lower,
        upper=upper,
        description=description,
        **options,
    )
