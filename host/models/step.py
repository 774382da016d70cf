"""One RK4 step of the hybrid closed loop, written once for symbols and numbers (paper eq. 7).

CasADi differentiates it for learning and plans, and evaluates it where there is no compiler. The C over SIMD
lanes has the same arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import casadi as ca

from trimtab.host.codegen.batch import vectorised
from trimtab.host.codegen.interrupts import held_interrupts
from trimtab.host.models.network import Layout
from trimtab.host.models.phi import Phi

ALONG = (0.0, 0.5, 0.5, 1.0)
"""Where RK4 evaluates the slope, in steps."""

SHARE = (1.0, 2.0, 2.0, 1.0)
"""Sixths of the step for which each slope counts."""


def rk4(slope: Callable[[Any, int], Any], x: Any, step: Any) -> Any:
    """Return x after a step. slope(x, half): the derivative, at half step 0, 1 or 2."""
    rate = total = slope(x, 0)
    for along, share in zip(ALONG[1:], SHARE[1:], strict=True):
        rate = slope(x + along * step * rate, round(2 * along))
        total = total + share * rate
    return x + step / 6.0 * total


@lru_cache(maxsize=8)
@held_interrupts()
def step_function(phi: Phi, layout: Layout | None, lanes: int) -> ca.Function:
    """Return the step of phi with a network of this layout over lanes.

    (x, flight, theta, xi, step_s, drive0, drive1, drive2, push0, push1, push2) -> next. All are matrices
    (lanes, rows) except for the weights xi and the step. The drive and `push`, an acceleration, NED, are
    those at the start, middle and end of the step.
    """
    function = vectorised(phi.function, lanes)
    x, drive, flight, theta, push = function.mx_in()
    drives = [ca.MX.sym(f"drive{i}", drive.shape) for i in range(3)]
    pushes = [ca.MX.sym(f"push{i}", push.shape) for i in range(3)]
    xi, step_s = ca.MX.sym("xi", 0 if layout is None else layout.size), ca.MX.sym("step_s")

    def slope(at: ca.MX, half: int) -> ca.MX:
        d = pushes[half]
        if layout is not None:
            d = d + layout.matrices(xi, at[:, 3:9].T).T
        return function(at, drives[half], flight, theta, d)

    inputs = {"x": x, "flight": flight, "theta": theta, "xi": xi, "step_s": step_s}
    inputs |= {f"drive{i}": each for i, each in enumerate(drives)}
    inputs |= {f"push{i}": each for i, each in enumerate(pushes)}
    return ca.Function("step", list(inputs.values()), [rk4(slope, x, step_s)], list(inputs), ["next"])
