"""Interface between a host-side controller and the session that streams its commands.

Times are integer microseconds since the start of the reference, negative before it. A command takes effect
after a declared computing time and the delay of the uplink. A controller predicts the state forward,
through the commands already sent, to the time at which its own command acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Protocol

from trimtab.protocol.blobs import Reference

Triple = tuple[float, float, float]


class StateEstimate(NamedTuple):
    """Estimated state at `t_us`: position (m) and velocity (m/s) in NED, attitude, body rate (rad/s, FRD)."""

    t_us: int
    p_ned: Triple
    v_ned: Triple
    q_ned_frd: tuple[float, float, float, float]
    rate_frd: Triple


class RateCommand(NamedTuple):
    """Body rate (rad/s, FRD) and nominal collective thrust (N), in effect from `t_us` until the next one."""

    t_us: int
    rate_frd: Triple
    collective_n: float


class SolveStatus(IntEnum):
    """Outcome of one control step."""

    SOLVED = 0
    BUDGET_SPENT = 1
    INFEASIBLE = 2


@dataclass(frozen=True, kw_only=True)
class ControlStep:
    """Result of one control step.

    Attributes
    ----------
    command
        Command to send. After BUDGET_SPENT or INFEASIBLE it comes from the last solved plan, shifted in time.
        None once that plan has ended: nothing is sent, and the hold of the firmware takes over.
    status
        Outcome of the solver.
    iterations
        Iterations that the solver used.
    """

    command: RateCommand | None
    status: SolveStatus
    iterations: int


class Controller(Protocol):
    """A controller on the host. It is deterministic: the same calls return the same commands."""

    @property
    def period_us(self) -> int:
        """Time between two control steps."""
        ...

    def begin(self, reference: Reference) -> None:
        """Prepare to follow `reference`; forget all earlier steps."""
        ...

    def step(self, estimate: StateEstimate, sent: Sequence[RateCommand], act_us: int) -> ControlStep:
        """Return the command that takes effect at `act_us`.

        sent: commands already sent, oldest first, each with the time of its effect. The first acts
        at or before `estimate.t_us`.
        """
        ...
