"""A controller for tests of the stream: the vehicle's outer loop, at the state predicted for its command."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.dfbc import FlatState, outer_loop
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import quat_to_matrix
from trimtab.host.control.interface import ControlStep, RateCommand, SolveStatus, StateEstimate, Triple
from trimtab.host.log.tracking import reference_at
from trimtab.host.vehicle import Vehicle, to_parameters
from trimtab.protocol.blobs import Reference

PREDICTION_US = 1000


class RateController:
    """Follows a reference by body rate and thrust. Records the estimates and commands that it was given.

    `outcome` returns status and whether there is a command, for each time of a step.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        period_us: int = 25_000,
        outcome: Callable[[int], tuple[SolveStatus, bool]] = lambda t_us: (SolveStatus.SOLVED, True),
    ) -> None:
        parameters = law.parameter_vector(to_parameters(vehicle))
        self._gains, self._model = law.gains(parameters), law.body(parameters)
        self._period_us = period_us
        self._outcome = outcome
        self._reference: Reference | None = None
        self.begun = 0
        self.calls: list[tuple[StateEstimate, tuple[RateCommand, ...], int]] = []

    @property
    def period_us(self) -> int:
        return self._period_us

    def begin(self, reference: Reference) -> None:
        self._reference = reference
        self.begun += 1
        self.calls.clear()

    def step(self, estimate: StateEstimate, sent: Sequence[RateCommand], act_us: int) -> ControlStep:
        assert self._reference is not None
        self.calls.append((estimate, tuple(sent), act_us))
        status, gives = self._outcome(act_us)
        if not gives:
            return ControlStep(command=None, status=status, iterations=0)
        p, v, q = predicted(estimate, sent, act_us, self._model.mass_kg)
        flat = reference_at(self._reference, np.array([act_us]))[0].tolist()
        reference = FlatState(flat[0:3], flat[3:6], flat[6:9], flat[9:12], flat[12], flat[13])
        R = quat_to_matrix(FLOAT, q)
        collective, rate = outer_loop(FLOAT, self._gains, self._model, p, v, R, reference)
        command = RateCommand(act_us, (rate[0], rate[1], rate[2]), collective)
        return ControlStep(command=command, status=status, iterations=1)


def predicted(
    estimate: StateEstimate, sent: Sequence[RateCommand], until_us: int, mass_kg: float
) -> tuple[Triple, Triple, tuple[float, float, float, float]]:
    """Position, velocity and attitude after the commands in effect until then, which the vehicle follows."""
    p, v, q = list(estimate.p_ned), list(estimate.v_ned), list(estimate.q_ned_frd)
    t_us, k = estimate.t_us, 0
    while t_us < until_us:
        while k + 1 < len(sent) and sent[k + 1].t_us <= t_us:
            k += 1
        dt = min(PREDICTION_US, until_us - t_us) * 1e-6
        R, thrust = quat_to_matrix(FLOAT, q), sent[k].collective_n / mass_kg
        for i, gravity in enumerate((0.0, 0.0, GRAVITY)):
            a = gravity - R[3 * i + 2] * thrust
            p[i] += dt * (v[i] + 0.5 * dt * a)
            v[i] += dt * a
        w, x, y, z = q
        a, b, c = (0.5 * dt * rate for rate in sent[k].rate_frd)
        q = [
            w - a * x - b * y - c * z,
            x + a * w + c * y - b * z,
            y + b * w - c * x + a * z,
            z + c * w + b * x - a * y,
        ]
        length = sum(value * value for value in q) ** 0.5
        q = [value / length for value in q]
        t_us += PREDICTION_US
    return (p[0], p[1], p[2]), (v[0], v[1], v[2]), (q[0], q[1], q[2], q[3])
