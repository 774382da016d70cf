"""Vehicles that were weakened on purpose. A policy study that does not catch them proves nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any
from unittest.mock import patch

from trimtab.firmware_model.flight import flight as flight_module
from trimtab.firmware_model.flight.condition_monitor import ConditionMonitor
from trimtab.firmware_model.flight.failsafe import Action, Condition
from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.gate import CommandGate
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.services.ownership import Ownership
from trimtab.firmware_model.services.parameter_service import ParameterService
from trimtab.firmware_model.services.setpoint_service import SetpointService

Patches = list[Any]


def _lower_action() -> Patches:
    """Let any action replace that of a failsafe."""
    trigger = Flight._trigger

    def replaced(self: Flight, condition: Condition, now_us: int) -> None:
        if self.state is State.FAILSAFE and condition.action < self.action:
            self.action = Action.NONE
        trigger(self, condition, now_us)

    return [
        patch.object(Flight, "_trigger", replaced),
        patch.object(flight_module, "escalate", lambda current, condition: condition.action),
    ]


def _no_arming_checks() -> Patches:
    """Arm whatever the checks say."""
    refusal = CommandGate.refusal

    def accepted(self: CommandGate, event: Event, now_us: int, **keywords: Any) -> str | None:
        return None if event is Event.ARM else refusal(self, event, now_us, **keywords)

    return [patch.object(CommandGate, "refusal", accepted)]


def _no_fence_ahead() -> Patches:
    """Never predict a stopping point outside the fence."""
    return [patch.object(Flight, "_stops_outside", lambda self, now_us: False)]


class _InStandby:
    """A flight that claims to be in standby."""

    state = State.STANDBY

    def __init__(self, flight: Any) -> None:
        self.configure: Callable[[], None] = flight.configure


def _parameters_in_flight() -> Patches:
    """Set parameters in every state."""
    set_standby = ParameterService.set

    def accepted(self: ParameterService, message: Any, now_us: int) -> None:
        with patch.object(self, "_flight", _InStandby(self._flight)):
            set_standby(self, message, now_us)

    return [patch.object(ParameterService, "set", accepted)]


def _early_touchdown() -> Patches:
    """Take a low height for a touchdown."""

    def touched(self: ConditionMonitor, now_us: int, *, height: float, **same: Any) -> bool:
        return height < 0.4

    return [patch.object(ConditionMonitor, "update_touchdown", touched)]


def _no_setpoint_timeout() -> Patches:
    """Fly on after the last setpoint."""
    active = ConditionMonitor.active_conditions

    def others(self: ConditionMonitor) -> list[Condition]:
        return [row for row in active(self) if row.event is not Event.SETPOINTS_LOST]

    return [patch.object(ConditionMonitor, "active_conditions", others)]


def _not_finite() -> Patches:
    """Follow numbers of setpoints that are not finite."""

    def fields(self: SetpointService, numbers: Sequence[float], ignored: int) -> list[float | None]:
        return [None if ignored >> k & 1 else number for k, number in enumerate(numbers)]

    return [patch.object(SetpointService, "_fields", fields)]


def _anybody() -> Patches:
    """Take commands from every station."""
    return [patch.object(Ownership, "refusal", lambda self, *arguments, **keywords: None)]


MUTANTS: Mapping[str, Callable[[], Patches]] = {
    "lower-action": _lower_action,
    "no-arming-checks": _no_arming_checks,
    "no-fence-ahead": _no_fence_ahead,
    "parameters-in-flight": _parameters_in_flight,
    "early-touchdown": _early_touchdown,
    "no-setpoint-timeout": _no_setpoint_timeout,
    "not-finite": _not_finite,
    "anybody": _anybody,
}
"""What weakens the vehicle, by name."""


@contextlib.contextmanager
def mutated(name: str | None) -> Iterator[None]:
    """Weaken every vehicle inside the context; None leaves them whole."""
    with contextlib.ExitStack() as stack:
        for each in MUTANTS[name]() if name is not None else ():
            stack.enter_context(each)
        yield
