"""What a candidate effect is: equation, parameters, where it enters the model, what closing the loop means.

An effect changes the nominal model only through slots. Every slot takes `ops` first (the arithmetic: floats,
CasADi scalars or numpy lanes) and `theta`, the effect's own parameter values in the order of
`Effect.parameters`; at the neutral values every slot leaves the model as it was.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from trimtab.firmware_model.law.ops import Ops

Scalar = Any
Theta = Sequence[Scalar]
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_KEY = re.compile(r"[a-z][a-z0-9_]*")


class Context(NamedTuple):
    """The state a slot may look at: SI units, world NED, body FRD.

    `thrust` and `collective_n` are the lagged rotor thrusts: before the thrust factors where a thrust factor
    is asked for, after them everywhere else. `voltage_ratio` is battery voltage over full voltage, 1 where
    it is not known. `R` is R_ned_frd, row-major. `hover_n` is a rotor's thrust at hover, `inertia_kg_m2` the
    vehicle file's principal moments. `memory` holds the effect's own states, empty where it has none.
    """

    p_ned: Sequence[Scalar]
    v_ned: Sequence[Scalar]
    v_air_frd: Sequence[Scalar]
    R: Sequence[Scalar]
    rate_frd: Sequence[Scalar]
    thrust: Sequence[Scalar]
    collective_n: Scalar
    mass_kg: Scalar
    voltage_ratio: Scalar
    t_s: Scalar
    rotor_positions: Sequence[Sequence[float]]
    spin_signs: Sequence[float]
    inertia_kg_m2: Sequence[float]
    hover_n: float
    memory: Sequence[Scalar] = ()


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect.

    `neutral` changes nothing. `typical` is the usual distance from neutral where the effect is present,
    `tolerance` one sigma of what is not worth naming (a vehicle file may override it), `lower` and `upper`
    bound the value. One that only says how, and changes nothing by itself, as a line's length does without a
    payload, is no `strength`.
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


def number(
    key: str,
    unit: str,
    neutral: float,
    typical: float,
    tolerance: float,
    lower: float,
    upper: float,
    description: str,
) -> Parameter:
    """A Parameter in one line, for a workspace's own effects."""
    return Parameter(
        key=key,
        unit=unit,
        neutral=neutral,
        typical=typical,
        tolerance=tolerance,
        lower=lower,
        upper=upper,
        description=description,
    )


@dataclass(frozen=True, kw_only=True)
class Closing:
    """What closing the loop on this effect means, as sentences for the report.

    `planner` begins with "nothing" where plans stay as they are, and with "nothing:" where even a star
    (the model in the dynamics) changes none. `law` is None where the control law on board cannot compensate
    it.
    """

    model: str
    planner: str
    law: str | None


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A candidate: one named piece of physics the nominal model does not have.

    `title` is made of the name where none is given. `aliases` names the effects it is mistaken for;
    `requires_any` those of which one must be present for this one to change anything. `observable` says in a
    sentence what a flight must do to show it. `one_of`: exactly one of the parameters leaves neutral (one
    rotor of four), each is a candidate of its own. `memory` counts the effect's own states: `memory_start`
    gives them at rest, `memory_rates` their derivatives. `starts` are values of all parameters from which a
    fit may begin, where from neutral the effect does not show by what it is. `source_id` is the first 12 hex
    of the SHA-256 of the file it came from, filled by the registry.

    Slots: factors on mass, on all rotors' thrust, on each rotor's and on the principal moments of inertia;
    the air's velocity; gravity added in the frame of the measurements; specific force and torque; the
    rotors' lag; what a command and a pose are late by.
    """

    name: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    closing: Closing
    title: str = ""
    aliases: tuple[str, ...] = ()
    observable: str = ""
    requires_any: tuple[str, ...] = ()
    one_of: bool = False
    memory: int = 0
    starts: tuple[Theta, ...] = ()
    mass_factor: Callable[[Ops, Theta], Scalar] | None = None
    thrust_factor: Callable[[Ops, Theta, Context], Scalar] | None = None
    rotor_factors: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    inertia_factors: Callable[[Ops, Theta], Sequence[Scalar]] | None = None
    wind_ned: Callable[[Ops, Theta], Sequence[Scalar]] | None = None
    gravity_ned: Callable[[Ops, Theta], Sequence[Scalar]] | None = None
    specific_force_frd: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    torque_frd: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    motor_lag_s: Callable[[Ops, Theta, Scalar], Scalar] | None = None
    command_delay_s: Callable[[Ops, Theta], Scalar] | None = None
    mocap_latency_s: Callable[[Ops, Theta], Scalar] | None = None
    memory_start: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    memory_rates: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    to_feedforward: Callable[[Sequence[float]], Mapping[str, Any]] | None = None
    source_id: str = ""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"effect name {self.name!r} is not lower-case words joined by hyphens")
        if not self.title:
            object.__setattr__(self, "title", self.name.replace("-", " ").capitalize())
        if not self.parameters:
            raise ValueError(f"effect {self.name}: no parameters")
        if len(set(self.keys)) != len(self.keys):
            raise ValueError(f"effect {self.name}: parameter keys repeat: {self.keys}")
        if self.name in self.aliases:
            raise ValueError(f"effect {self.name} names itself as alias")
        if not any(getattr(self, slot) is not None for slot in SLOTS):
            raise ValueError(f"effect {self.name} fills none of the slots {SLOTS}")
        if (self.memory > 0) != (self.memory_start is not None) or (self.memory > 0) != (
            self.memory_rates is not None
        ):
            raise ValueError(f"effect {self.name}: memory, memory_start and memory_rates go together")
        if (self.closing.law is None) != (self.to_feedforward is None):
            raise ValueError(f"effect {self.name}: closing.law and to_feedforward must be given together")

    @property
    def keys(self) -> tuple[str, ...]:
        """The parameter keys, in the order of theta."""
        return tuple(parameter.key for parameter in self.parameters)

    @property
    def neutral(self) -> tuple[float, ...]:
        """The theta that changes nothing."""
        return tuple(parameter.neutral for parameter in self.parameters)


SLOTS = (
    "mass_factor",
    "thrust_factor",
    "rotor_factors",
    "inertia_factors",
    "wind_ned",
    "gravity_ned",
    "specific_force_frd",
    "torque_frd",
    "motor_lag_s",
    "command_delay_s",
    "mocap_latency_s",
)
