"""Comparison of flights of one route: tracking errors, measured in the same way, and deteriorations.

If the trace finds that poses are older than their stamps, positions are shifted to that earlier time. Without
this, a control law that compensates the delay and flies better would seem to fly worse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from trimtab.firmware_model.law.ops import FLOAT
from trimtab.host.apps.demo.plans import Planned
from trimtab.host.log import Flight
from trimtab.host.log.tracking import reference_at
from trimtab.host.models.slots import mocap_latency_s
from trimtab.host.trace.result import Trace

Array = np.ndarray
AXES = ("north", "east", "down")


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracked:
    """A flight compared with its reference over the tracking phase.

    Attributes
    ----------
    p_ned, error_m
        Positions and their deviations from the reference (n, 3), NED.
    stamped_rmse_m
        RMSE without the correction of stamps.
    predicted_rmse_m
        RMSE that the traced model predicted before the flight; None if the model came later.
    clipped_share
        Share of ticks in flight with saturated motors.
    battery_v
        Battery voltage at the start of tracking.
    """

    label: str
    log: str
    planned: Planned
    p_ned: Array
    error_m: Array
    stamped_rmse_m: float
    predicted_rmse_m: float | None
    clipped_share: float
    battery_v: float | None

    @property
    def norm_m(self) -> Array:
        """Distance from the reference (n,)."""
        return np.linalg.norm(self.error_m, axis=1)

    @property
    def rmse_m(self) -> float:
        """Root mean square of the distance."""
        return float(np.sqrt((self.norm_m**2).mean()))

    @property
    def max_m(self) -> float:
        """Greatest distance."""
        return float(self.norm_m.max())

    @property
    def axes_m(self) -> tuple[float, ...]:
        """Root mean square along each axis."""
        return tuple(float(x) for x in np.sqrt((self.error_m**2).mean(axis=0)))


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The first flights of a route, a new plan flown by the same law, and a flight with the effects applied.

    The last flies the new plan, or the first plan if there is no new one. `no_new_plan` and `no_applied` are
    the reasons for missing flights.
    """

    first: tuple[Tracked, ...]
    latency_s: float
    new_plan: Tracked | None = None
    applied: Tracked | None = None
    no_new_plan: str | None = None
    no_applied: str | None = None

    def __post_init__(self) -> None:
        for flown, reason in ((self.new_plan, self.no_new_plan), (self.applied, self.no_applied)):
            if (flown is None) != (reason is not None):
                raise ValueError(f"a flight or the reason why there is none, not {flown!r} and {reason!r}")

    @property
    def first_rmse_m(self) -> float:
        """RMSE of all first flights together."""
        return pooled_rmse_m(self.first)

    @property
    def spread_m(self) -> float:
        """Range of the RMSE of the first flights, which is due to chance."""
        every = [flight.rmse_m for flight in self.first]
        return max(every) - min(every)

    @property
    def flown(self) -> tuple[Tracked, ...]:
        """Every flight, in the order flown."""
        return (*self.first, *(f for f in (self.new_plan, self.applied) if f is not None))

    def to_json(self) -> dict[str, Any]:
        """Return the keys of the demo's answer, with further ones below `comparison`."""
        return {
            "tracking_rmse_first_m": self.first_rmse_m,
            "tracking_rmse_new_plan_m": None if self.new_plan is None else self.new_plan.rmse_m,
            "tracking_rmse_applied_m": None if self.applied is None else self.applied.rmse_m,
            "comparison": {
                "route": self.first[0].planned.route.name,
                "poses_taken_earlier_s": self.latency_s,
                "no_new_plan": self.no_new_plan,
                "no_applied": self.no_applied,
                "flights": [
                    {
                        "what": flight.label,
                        "log": flight.log,
                        "tracking_rmse_m": flight.rmse_m,
                        "tracking_max_m": flight.max_m,
                        "predicted_rmse_m": _finite(flight.predicted_rmse_m),
                        "tracking_rmse_as_stamped_m": flight.stamped_rmse_m,
                        "clipped_share": flight.clipped_share,
                        "battery_v": flight.battery_v,
                        "path_length_m": flight.planned.plan.path_length_m,
                        "mean_speed_m_s": flight.planned.plan.mean_speed_m_s,
                    }
                    for flight in self.flown
                ],
            },
        }


def pooled_rmse_m(flights: Sequence[Tracked]) -> float:
    """Return the root mean square of the flights' errors."""
    return sqrt(sum(flight.rmse_m**2 for flight in flights) / len(flights))


def tracked(
    label: str, flight: Flight, planned: Planned, *, latency_s: float, predicted_rmse_m: float | None = None
) -> Tracked:
    """Compare a flight with its reference, with poses `latency_s` older than their stamps."""
    assert flight.mocap is not None
    assert flight.tracking is not None
    stamps_us, p = flight.mocap.t_us, flight.mocap.p
    stamped, _ = _errors(flight, stamps_us, p)
    error, inside = _errors(flight, stamps_us - round(1e6 * latency_s), p)
    clipped, battery_v = 0.0, None
    if (status := flight.status) is not None:
        clipped = status.saturated_ticks[-1] / max(1, status.flight_ticks[-1])
        began = min(int(np.searchsorted(status.t_us, flight.tracking[0])), len(status) - 1)
        battery_v = float(status.battery_v[began])
    return Tracked(
        label=label,
        log=flight.path.name,
        planned=planned,
        p_ned=p[inside],
        error_m=error,
        stamped_rmse_m=float(np.sqrt((stamped**2).sum(axis=1).mean())),
        predicted_rmse_m=predicted_rmse_m,
        clipped_share=float(clipped),
        battery_v=battery_v,
    )


def _errors(flight: Flight, t_us: Array, p_ned: Array) -> tuple[Array, Array]:
    """Return position errors (n, 3) in the tracking phase, and the mask of these positions."""
    assert flight.reference is not None
    assert flight.tracking is not None
    start_us, end_us = flight.tracking
    inside = (t_us >= start_us) & (t_us <= end_us)
    return p_ned[inside] - reference_at(flight.reference, t_us[inside] - start_us)[:, :3], inside


def _finite(value: float | None) -> float | None:
    """Return the value, or None if it is not finite."""
    return value if value is not None and np.isfinite(value) else None


def latency_of(result: Trace) -> float:
    """Return the seconds by which poses are older than their stamps, from the named effects."""
    return float(mocap_latency_s(FLOAT, result.model.parts(result.space.effects, "effects")))


def what_got_worse(comparison: Comparison, result: Trace, names: Mapping[str, str]) -> list[str]:
    """Return a sentence for each flight or prediction that is worse in some figure.

    A flight is worse if its figure exceeds that of every first flight. names: of held-out flights, by id.
    """
    out = []
    for flight in (comparison.new_plan, comparison.applied):
        if flight is None:
            continue
        worse = []
        for name, value, before in _figures(flight, comparison.first):
            if value > max(before):
                worse.append(f"{name} {1e3 * max(before):.1f} to {1e3 * value:.1f} mm")
        clipped = max(first.clipped_share for first in comparison.first)
        if flight.clipped_share > clipped:
            worse.append(
                f"the share of time at the motors' limits {100 * clipped:.2f} to "
                f"{100 * flight.clipped_share:.2f} %"
            )
        if worse:
            out.append(f"{flight.label}: {', '.join(worse)}.")
    for b, a in zip(result.before, result.after, strict=True):
        before, after = (np.sqrt((e.p_error_ned**2).mean(axis=0)) for e in (b, a))
        worse = [
            f"{axis} {1e3 * before[i]:.1f} to {1e3 * after[i]:.1f} mm"
            for i, axis in enumerate(AXES)
            if after[i] > before[i]
        ]
        if worse:
            out.append(f"Prediction of held-out flight {names[b.flight]}: {', '.join(worse)}.")
    return out


def _figures(flight: Tracked, first: Sequence[Tracked]) -> list[tuple[str, float, list[float]]]:
    """Return name, value and the first flights' values of each error."""
    rows = [
        ("tracking RMSE", flight.rmse_m, [f.rmse_m for f in first]),
        ("greatest error", flight.max_m, [f.max_m for f in first]),
    ]
    for i, axis in enumerate(AXES):
        rows.append((f"RMSE {axis}", flight.axes_m[i], [f.axes_m[i] for f in first]))
    return rows
