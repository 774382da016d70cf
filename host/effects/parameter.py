"""Parameters of an effect: neutral and typical value, bounds, tolerance, unit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TypedDict, Unpack

DISCREPANCY = 0.05
"""Usual `Parameter.discrepancy`."""
LOOP_DISCREPANCY = 0.01
"""Usual `Parameter.loop_discrepancy`."""
_KEY = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect.

    Attributes
    ----------
    key, unit, description
        Its name in `lower_snake_case`, its unit ("1" for none) and its meaning.
    neutral
        The value that changes nothing.
    typical
        Usual distance from neutral where the effect is present; the scale of every fit.
    tolerance
        One sigma of what is not worth naming. A vehicle file may override it.
    lower, upper
        Bounds of the value.
    strength
        False for a parameter that changes nothing by itself, such as a line's length without a payload.
    discrepancy
        One sigma, in typical sizes, of what segments of flights read into the parameter where the effect is
        absent, since the model's form is not exact.
    loop_discrepancy
        The same for whole flights over the closed loop.
    free_sigma
        One sigma of the value where a log leaves the effect free (`Effect.freed_by`); `typical` if absent.
    free_lower, free_upper
        Bounds of the value there; `lower` and `upper` if absent. An effect that takes either sign only there
        has a negative `free_lower`.
    measured_below
        A tolerance below this one means that the value was measured: the effect is then no exact alias of
        another. Absent where no measurement is known.

    All but the texts, `strength` and the two discrepancies are in the parameter's unit.
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
        if not 0.0 < self.tolerance < self.typical:
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
        """Bounds of the value where a log leaves the effect free."""
        return (
            self.lower if self.free_lower is None else self.free_lower,
            self.upper if self.free_upper is None else self.free_upper,
        )

    @property
    def has_free_facts(self) -> bool:
        """Whether anything is stated about the parameter where a log leaves the effect free."""
        return any(fact is not None for fact in (self.free_sigma, self.free_lower, self.free_upper))


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
    """Return a Parameter in one line, for a workspace's own effects; arguments as of `Parameter`."""
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
