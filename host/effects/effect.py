"""Definition of a candidate effect: equation, parameters, slots of the model, and closing of the loop.

An effect changes the nominal model only through slots. The first argument of every slot is `ops`, the
arithmetic: floats, CasADi scalars or NumPy lanes. The second is `theta`, the parameter values of the effect
in the order of `Effect.parameters`. At the neutral values no slot changes the model.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

from trimtab.firmware_model.law.ops import Ops
from trimtab.host.effects.parameter import Parameter
from trimtab.host.effects.unknowns import UNKNOWN

Scalar = Any
Theta = Sequence[Scalar]
_FLOOR = 1e-9  # keeps the derivative of the square root finite at zero thrust
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

Family = Literal["force", "torque", "timing", "aerodynamic"]
"""What an effect acts as. Studies group their figures by it."""

Signal = Literal["voltage_ratio", "gyro"]
"""A signal that an effect may need: battery voltage over full voltage, or the body rate of a gyro, rad/s."""


class Context(NamedTuple):
    """The state that a slot may use: SI units, world NED, body FRD.

    For `memory_start` and `thrust_rate_torque_frd` it is that of the nominal vehicle: nominal mass, thrusts
    without factors, air at rest, a full battery, and time 0.

    Attributes
    ----------
    p_ned, v_ned
        Position and velocity (3,).
    v_air_frd
        Velocity relative to the air (3,), body axes.
    R
        R_ned_frd (9,), row-major.
    rate_frd
        Body rate (3,), rad/s.
    thrust, collective_n
        Thrust of each rotor after the motor lag (4,), and their sum, N. They include the thrust factors of
        all effects, except in the slots `thrust_factor` and `rotor_factors`.
    mass_kg
        Mass, with the mass factors of all effects.
    voltage_ratio
        Battery voltage over full voltage; 1 if it is unknown.
    t_s
        Time.
    rotor_positions, spin_signs
        Position (4, 3) in m, FRD, and sense of rotation (4,) of each rotor; +1 is ccw seen from above.
    inertia_kg_m2
        Principal moments of inertia (3,) in the vehicle file.
    hover_n
        Thrust of one rotor at hover.
    torque_per_thrust_m
        Drag torque of a rotor over its thrust.
    memory
        States that the effect adds; empty if it adds none.
    a_ned
        Acceleration of the vehicle (3,), m/s^2, with all effects; only for `memory_rates`.
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
    torque_per_thrust_m: float = 0.0
    memory: Sequence[Scalar] = ()
    a_ned: Sequence[Scalar] = ()

    def excess_speed(self, ops: Ops, thrust_n: Scalar | None = None) -> Scalar:
        """Return the rotor speed over that at hover, minus 1.

        thrust_n: thrust of one rotor; None for the mean of all rotors.
        """
        thrust, hover = (
            (self.collective_n, 4.0 * self.hover_n) if thrust_n is None else (thrust_n, self.hover_n)
        )
        return ops.sqrt(ops.maximum(thrust, 0.0) / hover + _FLOOR) - 1.0


@dataclass(frozen=True, kw_only=True)
class ExactAlias:
    """Another effect that fits every flight exactly as well as the effect that states this alias.

    Attributes
    ----------
    effect
        Name of the other effect.
    remedy
        Measurement that distinguishes the two, as an instruction: "weigh the vehicle to ...".
    ratio
        Name of the ratio that flights do show, such as "thrust over mass": the first parameter of this effect
        over that of the other, both over their neutral values. None if flights show no ratio.
    """

    effect: str
    remedy: str
    ratio: str | None = None


@dataclass(frozen=True, kw_only=True)
class Closing:
    """Consequences of closing the loop on an effect, as sentences for the report.

    Attributes
    ----------
    model
        How the closed-loop model changes.
    planner
        How new plans change. It begins with "nothing" if ordinary plans do not change, and with "nothing:" if
        starred plans, which have the model in their dynamics, do not change either.
    law
        How the control law on board compensates the effect; None if it cannot.
    no_law
        Why it cannot; None if it can, or if no reason is stated.
    """

    model: str
    planner: str
    law: str | None
    no_law: str | None = None


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A candidate effect: one physical cause that the nominal model does not contain.

    Attributes
    ----------
    name, title, equation, source
        Name, lower-case words joined by hyphens; title for people, made from `name` if empty; equation that
        the effect adds to the model; and source of equation and sizes.
    parameters
        Parameters, in the order of theta.
    closing
        Consequences of closing the loop.
    family
        What the effect acts as; studies group their figures by it.
    aliases
        Names of effects that it may be confused with.
    exact_aliases
        Aliases that fit every flight exactly as well. One effect of each pair states the alias.
    separated_by
        Measurement that distinguishes the effect from an alias if no flight can, by the name of the alias.
        One effect of each pair states it.
    observed_relative_to
        Name of another effect, if flights show the parameters of this effect only relative to the first
        parameter of the other.
    observable
        Flights that show the effect, as a phrase.
    needs_signals
        Signals that the effect needs, each with the deviation from rest that at least one flight must exceed.
        Smaller deviations are noise. At rest `voltage_ratio` is 1 and `gyro` is 0 rad/s. Without these
        signals the effect is left out of the model.
    adjustment
        Whether the effect is in every model within its tolerance and is never a candidate.
    tolerance_of_motors
        Whether the tolerance that a vehicle file states is that of its `thrust_max_n`. It does not count in
        logs that hold commanded thrust in N.
    replaced_by
        Words of `unknown` in a log that take the effect out of the model, since a nuisance explains the same.
    freed_by
        Words of `unknown` in a log that free the effect. It is then in every model with `free_sigma` and is
        not a candidate. This takes precedence over `replaced_by`.
    requires_any
        Names of effects, of which one must be present for this effect to change anything.
    one_of
        Whether only one of the parameters may leave neutral, as for one rotor of four. Each parameter is then
        a candidate.
    slows_rotors
        Whether `thrust_factor` acts through the speed of the rotors, so that measured rotor speeds show it.
    changes_hover
        Whether the effect may change from one day to the next and then shows in the mean of a hover. It is a
        candidate of comparisons of hovers (`trimtab.host.trace.hover`), even if it is an adjustment.
    comes_with
        Names of effects that a change of this one brings: an attached mass moves the centre of mass. In a
        comparison of hovers they are one cause.
    form_torque
        Whether `torque_frd` is 0 at the neutral form (`Parameter.form`). No plan avoids such a torque.
    noise_dependent
        Whether the noise in the loop decides what the effect does, as it does where the effect is not smooth.
        Predictions of whole flights contain no noise, so they cannot show it. Neither do sampled commands.
    memory
        Number of states that the effect adds. `memory_start` gives their values at rest, `memory_rates` their
        derivatives.
    starts
        Values of all parameters from which a fit may start, if the slope at neutral does not show the effect.
    source_id
        First 12 hex digits of the SHA-256 of the effect's file, set by the registry.
    mass_factor
        Factor on the mass.
    thrust_factor
        Factor on the thrust of all rotors.
    rotor_factors
        Factors (4,) on the thrust of each rotor.
    inertia_factors
        Factors (3,) on the principal moments of inertia.
    added_inertia_kg_m2
        What is added to the inertia matrix (4,), given the mass, kg: its elements xx, yy, zz and xy.
    wind_ned
        Velocity of the air (3,), m/s.
    gravity_ned
        Acceleration (3,) that is added to gravity in the frame of the measurements, m/s^2.
    specific_force_frd
        Specific force (3,), m/s^2.
    torque_frd
        Torque (3,), N m.
    thrust_rate_torque_frd
        Torque (3,), N m, given the derivatives of the rotor thrusts (4,), N/s.
    motor_lag_s
        Time constant of the rotors, given the nominal one.
    driven_thrust_n
        Thrust that a command drives a rotor to, N, given the commanded thrust and the thrust at hover, N.
    lag_factor
        Factor on the time constant of a rotor, given the thrust that it is driven to and its thrust, N.
    command_delay_s
        Delay of the motor commands.
    mocap_latency_s
        Age of a pose at its time stamp.
    memory_start, memory_rates
        Values of the added states at rest, and their derivatives.
    to_feedforward
        Contributions to the feed-forward block on board; see `compose_feedforward`.
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
    tolerance_of_motors: bool = False
    replaced_by: tuple[str, ...] = ()
    freed_by: tuple[str, ...] = ()
    requires_any: tuple[str, ...] = ()
    one_of: bool = False
    slows_rotors: bool = False
    changes_hover: bool = False
    comes_with: tuple[str, ...] = ()
    form_torque: bool = False
    noise_dependent: bool = False
    memory: int = 0
    starts: tuple[Theta, ...] = ()
    mass_factor: Callable[[Ops, Theta], Scalar] | None = None
    thrust_factor: Callable[[Ops, Theta, Context], Scalar] | None = None
    rotor_factors: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    inertia_factors: Callable[[Ops, Theta], Sequence[Scalar]] | None = None
    added_inertia_kg_m2: Callable[[Ops, Theta, Scalar], Sequence[Scalar]] | None = None
    wind_ned: Callable[[Ops, Theta], Sequence[Scalar]] | None = None
    gravity_ned: Callable[[Ops, Theta], Sequence[Scalar]] | None = None
    specific_force_frd: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    torque_frd: Callable[[Ops, Theta, Context], Sequence[Scalar]] | None = None
    thrust_rate_torque_frd: Callable[[Ops, Theta, Context, Sequence[Scalar]], Sequence[Scalar]] | None = None
    motor_lag_s: Callable[[Ops, Theta, Scalar], Scalar] | None = None
    driven_thrust_n: Callable[[Ops, Theta, Scalar, float], Scalar] | None = None
    lag_factor: Callable[[Ops, Theta, Scalar, Scalar], Scalar] | None = None
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
            raise ValueError(f"effect {self.name}: duplicate parameter keys: {self.keys}")
        forms = [parameter.form for parameter in self.parameters]
        if sorted(forms) != forms or all(forms):
            raise ValueError(f"effect {self.name}: form parameters must follow at least one other parameter")
        if self.name in self.aliases:
            raise ValueError(f"effect {self.name} lists itself as an alias")
        if not any(getattr(self, slot) is not None for slot in SLOTS):
            raise ValueError(f"effect {self.name} fills none of the slots {SLOTS}")
        if (self.memory > 0) != (self.memory_start is not None) or (self.memory > 0) != (
            self.memory_rates is not None
        ):
            raise ValueError(
                f"effect {self.name}: memory, memory_start and memory_rates must be given together"
            )
        if (self.closing.law is None) != (self.to_feedforward is None):
            raise ValueError(f"effect {self.name}: closing.law and to_feedforward must be given together")
        if self.closing.law is not None and self.closing.no_law is not None:
            raise ValueError(f"effect {self.name}: closing.law and closing.no_law contradict each other")
        self._check_aliases()
        self._check_unknowns()
        if self.family not in get_args(Family):
            raise ValueError(f"effect {self.name}: family {self.family!r} is not one of {get_args(Family)}")
        self._check_signals()

    def _check_signals(self) -> None:
        """Raise ValueError for an unknown signal or an invalid bound."""
        for signal, bound in self.needs_signals.items():
            if signal not in get_args(Signal):
                raise ValueError(
                    f"effect {self.name}: needs_signals {signal!r} is not one of {get_args(Signal)}"
                )
            if not 0.0 <= bound < math.inf:
                raise ValueError(
                    f"effect {self.name}: needs_signals {signal} must be finite and >= 0, got {bound}"
                )

    def _check_aliases(self) -> None:
        """Raise ValueError if facts about other effects contradict the aliases or the parameters."""
        for alias in self.exact_aliases:
            if alias.effect not in self.aliases:
                raise ValueError(f"effect {self.name}: exact_aliases {alias.effect} is not in aliases")
            if alias.ratio is not None and self.neutral[0] == 0.0:
                raise ValueError(
                    f"effect {self.name}: exact_aliases {alias.effect} has a ratio, but {self.keys[0]} is 0 "
                    "at neutral"
                )
        for other in self.separated_by:
            if other not in self.aliases:
                raise ValueError(f"effect {self.name}: separated_by {other} is not in aliases")
        if self.observed_relative_to == self.name:
            raise ValueError(f"effect {self.name}: observed_relative_to is the effect itself")

    def _check_unknowns(self) -> None:
        """Raise ValueError for a word that a log may not declare unknown, or a contradiction."""
        for name in ("replaced_by", "freed_by"):
            words = getattr(self, name)
            if isinstance(words, str):
                raise ValueError(f"effect {self.name}: {name} must be a tuple of words, got {words!r}")
            unsupported = sorted(set(words) - set(UNKNOWN))
            if unsupported:
                raise ValueError(f"effect {self.name}: {name} {unsupported} is not in {UNKNOWN}")
        both = sorted(set(self.replaced_by) & set(self.freed_by))
        if both:
            raise ValueError(f"effect {self.name}: {both} in both replaced_by and freed_by")
        freed = [parameter.key for parameter in self.parameters if parameter.has_free_facts]
        if freed and not self.freed_by:
            raise ValueError(f"effect {self.name}: {freed} have free_* values, but freed_by is empty")

    def replaced(self, unknown: Iterable[str]) -> tuple[str, ...]:
        """Return the words of `unknown` that take the effect out of the model; none if one frees it."""
        words = tuple(unknown)
        if set(words) & set(self.freed_by):
            return ()
        return tuple(word for word in words if word in self.replaced_by)

    def theta(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return theta with these first values, and a neutral form."""
        return (*values, *self.neutral[len(values) :])

    @property
    def acts_on_rotor_speed(self) -> bool:
        """Whether measured rotor speeds show the effect."""
        timing = (self.motor_lag_s, self.driven_thrust_n, self.lag_factor, self.command_delay_s)
        return self.slows_rotors or any(slot is not None for slot in timing)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the parameters, in the order of theta."""
        return tuple(parameter.key for parameter in self.parameters)

    @property
    def neutral(self) -> tuple[float, ...]:
        """Theta at which the effect changes nothing."""
        return tuple(parameter.neutral for parameter in self.parameters)


SLOTS = (
    "mass_factor",
    "thrust_factor",
    "rotor_factors",
    "inertia_factors",
    "added_inertia_kg_m2",
    "wind_ned",
    "gravity_ned",
    "specific_force_frd",
    "torque_frd",
    "thrust_rate_torque_frd",
    "motor_lag_s",
    "driven_thrust_n",
    "lag_factor",
    "command_delay_s",
    "mocap_latency_s",
)
