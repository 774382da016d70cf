"""Detection of ground contact and of impacts."""

from __future__ import annotations

import numpy as np

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.host.trace.data.signals import (
    FlightData,
    Signals,
    averaged,
    local_quadratics,
    nominal_thrust,
    without_inputs,
)
from trimtab.host.trace.data.stretches import UnusedStretch, clipped_stretch, merged_spans, runs_of, within
from trimtab.host.trace.decision.findings import Code
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.vehicle import Vehicle

_WINDOW_S = 0.3
"""Length of the windows in which ground contact is detected."""

_WINDOW_STEP_S = 0.1
"""Step between the starts of these windows."""


def ground_contact(data: FlightData) -> list[UnusedStretch]:
    """Return the stretches in which the floor carries the vehicle or something hits it.

    The floor may carry the vehicle in two cases. Either the vehicle is close above its resting place. Or it
    is close above the lowest place of the log, is not falling, and the ratio of its specific force to its
    rotor thrust exceeds that of free flight. Without recorded inputs only impacts are detected.
    """
    flight, s = data.flight, data.signals
    t = np.arange(s.pose_s[0], s.pose_s[-1] - _WINDOW_S, _WINDOW_STEP_S)
    low, high = np.searchsorted(s.pose_s, t), np.searchsorted(s.pose_s, t + _WINDOW_S)
    enough = high - low >= 4
    t, low, high = t[enough], low[enough], high[enough]
    flying = (t + _WINDOW_S > s.span_s[0]) & (t < s.span_s[1])
    if without_inputs(flight) or not flying.any():
        return _impacts(data)
    spans = list(zip(low, high, strict=True))
    down = np.array([np.median(s.p_ned[a:b, 2]) for a, b in spans])
    thrust, force, speed = _window_means(flight.vehicle, s, t, low, high)
    touching = np.zeros(len(t), dtype=bool)
    still = np.array([np.ptp(s.p_ned[a:b], axis=0).max() < RULES.still_m for a, b in spans])
    if flight.kind == "flight":  # logged by Trimtab; imported logs may begin in the air
        touching = np.median(s.p_ned[s.pose_s < s.pose_s[0] + 0.1, 2]) - down < RULES.clear_m
    elif (resting := still & (thrust < RULES.resting_thrust_g * GRAVITY)).any():
        touching = np.median(down[resting]) - down < RULES.clear_m
    height = down.max() - down
    ratio = force / np.maximum(thrust, 0.1)
    powered = thrust > RULES.powered_share * np.nanmedian(thrust[flying])
    free_flight = ratio[powered & (height > RULES.free_height_m)]
    if len(free_flight) <= 5:
        free_flight = np.sort(ratio[powered])[: powered.sum() // 2 + 1]
    carried = (
        (ratio > RULES.support_ratio * np.median(free_flight))
        & (np.abs(speed) < RULES.level_speed_m_s)
        & (height < RULES.low_m)
    )
    bad = (touching | carried) & flying
    return [clipped_stretch(s, a, b + _WINDOW_S, Code.GROUND_CONTACT) for a, b in runs_of(t, bad)] + _impacts(
        data
    )


def _window_means(
    vehicle: Vehicle, s: Signals, t: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nominal thrust over mass, specific force along the thrust, and vertical speed in each window.

    Returns three arrays (n,). Thrust and force (m/s^2) are positive along the thrust, the speed (m/s)
    downwards. The accelerometer gives the force; without one, the curvature of the positions does. Means are
    NaN where samples cover too little of a window.

    Parameters
    ----------
    vehicle
        Vehicle of the flight.
    s
        Signals of the flight.
    t
        Starts (n,) of the windows, s since arming.
    low, high
        Index (n,) of the first pose in each window, and of the first pose after it.
    """
    rotor_thrusts = nominal_thrust(vehicle, s.command, in_newton=s.in_newton)
    edges = np.unique(np.concatenate([t, t + _WINDOW_S]))
    first, last = np.searchsorted(edges, t), np.searchsorted(edges, t + _WINDOW_S)

    def means(interval_s: np.ndarray, value: np.ndarray) -> np.ndarray:
        mean, share = averaged(edges, interval_s, value[:, None])
        weight = np.r_[0.0, np.cumsum(share * np.diff(edges))]
        area = np.r_[0.0, np.cumsum(mean[:, 0] * share * np.diff(edges))]
        length = weight[last] - weight[first]
        return np.where(
            length > RULES.min_coverage * _WINDOW_S,
            (area[last] - area[first]) / np.maximum(length, 1e-9),
            np.nan,
        )

    thrust = means(s.input_s, rotor_thrusts.sum(axis=1) / vehicle.mass_kg)
    half_s = 0.5 * _WINDOW_S
    quadratics = local_quadratics(s, s.pose_s[low] + half_s, low, high, half_s)
    speed = quadratics[:, 1, 2]
    if len(s.force_frd):
        force = -means(s.imu_s, s.force_frd[:, 2])
    else:
        acceleration = 2.0 * quadratics[:, 2]
        axis = s.R_ned_frd[(low + high) // 2, :, 2]
        force = -np.einsum("ni,ni->n", axis, acceleration - np.array([0.0, 0.0, GRAVITY]))
    return thrust, force, speed


def _impacts(data: FlightData) -> list[UnusedStretch]:
    """Return the stretches in which the accelerometer shows more than rotors and air can cause."""
    s, vehicle = data.signals, data.flight.vehicle
    if not len(s.force_frd):
        return []
    strongest = 4.0 * vehicle.thrust_max_n / vehicle.mass_kg
    beyond = RULES.impact_g * GRAVITY
    x, y, z = s.force_frd.T
    hit = (np.hypot(x, y) > beyond) | (z > beyond) | (z < -strongest - beyond)
    middle = s.imu_s.mean(axis=1)
    tracking = within(middle, s.span_s)
    spans = merged_spans([(a - 0.1, b + 0.1) for a, b in runs_of(middle[tracking], hit[tracking])])
    return [clipped_stretch(s, a, b, Code.IMPACT) for a, b in spans]
