"""What a candidate effect is: equation, parameters, where it enters the model, what closing the loop means.

An effect changes the nominal model only through slots. Every slot takes `ops` first (the arithmetic: floats,
CasADi scalars or numpy lanes) and `theta`, the effect's own parameter values in the order of
`Effect.parameters`; at the neutral values every slot leaves the model as it was.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

from trimtab.firmware_model.law.ops import Ops
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import UNKNOWN

Scalar = Any
Theta = Sequence[Scalar]
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

Family = Literal["force", "torque", "timing", "aerodynamic"]
"""What an effect acts as, by which studies group their figures."""

Signal = Literal["voltage_ratio", "gyro"]
"""A signal that an effect may need: battery voltage over full voltage, or the body rate by a gyro, rad/s."""


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
class ExactAlias:
    """Another effect that fits every flight exactly as well as the one that states it.

    Attributes
    ----------
    effect
        Name of the other effect.
    remedy
        What tells the two apart, as a sentence for the verdict: "weigh the vehicle to ...".
    ratio
        What flights do show of the two, in words ("thrust over mass"): this effect's first parameter over the
        other's, both over their neutral values. Absent where they show no ratio.
    """

    effect: str
    remedy: str
    ratio: str | None = None


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

    Attributes
    ----------
    name, title, equation, source
        Its name in lower-case words joined by hyphens, its name for people (made of `name` if absent), what
        it adds to the model, and where that comes from.
    parameters
        Its numbers, in the order of theta.
    closing
        What closing the loop on it means.
    family
        What it acts as; studies group their figures by it.
    aliases
        Names of the effects it is mistaken for.
    exact_aliases
        Those that fit every flight exactly as well. Each is stated by one effect of the two.
    separated_by
        By the name of an alias, what to measure where no flight tells the two apart. One effect of the two
        states it.
    observed_relative_to
        Name of an effect: flights show the parameters of this one only over the first parameter of that one.
    observable
        What a flight must do to show it, as a sentence.
    needs_signals
        By signal, the least departure from rest (1 for `voltage_ratio`, 0 rad/s for `gyro`) in the flight
        that departs most; less is noise. Without them the effect is left out of the model.
    adjustment
        True for an effect that is in every model within its tolerance and never is a candidate.
    replaced_by
        What a log may declare unknown that takes the effect out of the model: a nuisance explains the same.
    freed_by
        What a log may declare unknown that is this effect: it is then in every model with `free_sigma`, not
        a candidate, also where something else would replace it.
    requires_any
        Names of the effects of which one must be present for this one to change anything.
    one_of
        Whether exactly one of the parameters leaves neutral (one rotor of four); each is then a candidate.
    memory
        Number of the effect's own states: `memory_start` gives them at rest, `memory_rates` their
        derivatives.
    starts
        Values of all parameters from which a fit may begin, where the effect does not show from neutral.
    source_id
        First 12 hex digits of the SHA-256 of the file it came from, filled by the registry.

    The other attributes are the slots: factors on mass, on all rotors' thrust, on each rotor's and on the
    principal moments of inertia; the air's velocity; gravity added in the frame of the measurements; specific
    force and torque; the rotors' lag; what a command and a pose are late by.
    """

    name: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    closing: Closing
    title: str = ""
    family: Family = "force"
    aliases: tuple[str, ...] = ()
    exact_aliases: tuple[ExactAlias, ...] = ()
    separated_by: Mapping[str, str] = field(default_factory=dict, hash=False)
    observed_relative_to: str | None = None
    observable: str = ""
    needs_signals: Mapping[Signal, float] = field(default_factory=dict, hash=False)
    adjustment: bool = False
    replaced_by: tuple[str, ...] = ()
    freed_by: tuple[str, ...] = ()
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
        self._check_aliases()
        self._check_unknowns()
        if self.family not in get_args(Family):
            raise ValueError(f"effect {self.name}: family {self.family!r} is none of {get_args(Family)}")
        self._check_signals()

    def _check_signals(self) -> None:
        """Raise ValueError for a needed signal that is none, or a bound that is no size."""
        for signal, least in self.needs_signals.items():
            if signal not in get_args(Signal):
                raise ValueError(
                    f"effect {self.name}: needs_signals {signal!r} is none of {get_args(Signal)}"
                )
            if not 0.0 <= least < math.inf:
                raise ValueError(
                    f"effect {self.name}: needs_signals {signal} must be finite and >= 0, got {least}"
                )

    def _check_aliases(self) -> None:
        """Raise ValueError where facts about other effects do not agree with the aliases or parameters."""
        for alias in self.exact_aliases:
            if alias.effect not in self.aliases:
                raise ValueError(f"effect {self.name}: exact_aliases {alias.effect} is none of its aliases")
            if alias.ratio is not None and self.neutral[0] == 0.0:
                raise ValueError(
                    f"effect {self.name}: exact_aliases {alias.effect} has a ratio, but {self.keys[0]} is 0 "
                    "at neutral"
                )
        for other in self.separated_by:
            if other not in self.aliases:
                raise ValueError(f"effect {self.name}: separated_by {other} is none of its aliases")
        if self.observed_relative_to == self.name:
            raise ValueError(f"effect {self.name}: observed_relative_to is the effect itself")

    def _check_unknowns(self) -> None:
        """Raise ValueError where a word is none that a log may declare unknown."""
        for name in ("replaced_by", "freed_by"):
            words = getattr(self, name)
            if isinstance(words, str):
                raise ValueError(f"effect {self.name}: {name} must be a tuple of words, got {words!r}")
            strange = sorted(set(words) - set(UNKNOWN))
            if strange:
                raise ValueError(f"effect {self.name}: {name} {strange} is none of {UNKNOWN}")
        both = sorted(set(self.replaced_by) & set(self.freed_by))
        if both:
            raise ValueError(f"effect {self.name}: {both} in replaced_by and in freed_by")
        stated = [parameter.key for parameter in self.parameters if parameter.has_free_facts]
        if stated and not self.freed_by:
            raise ValueError(f"effect {self.name}: {stated} say what is free, but freed_by names no unknown")

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
