"""On-board check of a blob against the parameters and limits of the vehicle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum

from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.law import feedforward as law
from trimtab.firmware_model.law.checks import check_reference
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.reference_verdict import ReferenceReason
from trimtab.firmware_model.law.rotations import euler_to_matrix
from trimtab.protocol.blobs import NEUTRAL_BLOCK, BlobError, FeedForward, Reference, from_bytes
from trimtab.protocol.upload import Verdict


class Reason(IntEnum):
    """Reasons of a refusal in addition to ReferenceReason (below 100). Part of the protocol."""

    BAD_BLOB = 100
    OTHER_VEHICLE = 101
    OTHER_KIND = 102
    FEEDFORWARD_RANGE = 103
    NOT_CONTINUOUS = 104  # jump from the present reference at the swap
    TOO_LATE = 105


GAIN_RANGE = (0.3, 3.0)
"""Bounds of the gain (actual over nominal thrust) of a feed-forward."""
BIAS_MAX = 5.0
"""Greatest bias, m/s^2."""
DRAG_MAX = 5.0
"""Greatest linear (1/s) and quadratic (1/m) drag coefficient."""
OFFSET_MAX = 0.2
"""Greatest attitude offset, rad."""
PREDICTION_MAX_S = 0.1
WIND_MAX = 15.0
"""Greatest component of the wind, m/s."""
EXPONENT_MAX = 5.0
"""Greatest magnitude of the voltage exponent."""
NETWORK_MAX = 5.0
"""Greatest residual acceleration (m/s^2) of a network at the bounds of its region."""
NETWORK_SPEED = 10.0
"""Speed (m/s) up to which a network without a region is checked."""
NETWORK_TILT = 1.0
"""Tilt (rad) up to which a network without a region is checked."""
BATTERY_RESERVE = 0.05
"""Share of the available thrust that a reference leaves for the controller and for further voltage sag."""
BATTERY_LOW_CELL_V = 0.1
"""Least cell voltage above empty at which a reference is accepted."""

_ZERO = (0.0, 0.0, 0.0)


def check_blob(
    kind: int, data: bytes, *, parameters: ParameterValues, vehicle_id: str, battery_v: float = 0.0
) -> Verdict:
    """Return the verdict on a blob. Never raises.

    battery_v: last measured voltage; 0 without a measurement, which skips the check of the battery.
    """
    try:
        blob = from_bytes(data)
    except BlobError as error:
        return _refused(Reason.BAD_BLOB, str(error))
    blob_kind = int(blob.KIND)
    if blob_kind != kind:
        return _refused(Reason.OTHER_KIND, f"announced as kind {kind}, but it is kind {blob_kind}")
    if blob.vehicle_id != vehicle_id:
        return _refused(Reason.OTHER_VEHICLE, f"made for vehicle {blob.vehicle_id}, this is {vehicle_id}")
    if isinstance(blob, Reference):
        return battery_verdict(parameters, battery_v) or _check_reference(blob, parameters, battery_v)
    return _check_feedforward(blob)


def battery_verdict(parameters: ParameterValues, battery_v: float) -> Verdict | None:
    """Return the refusal of any reference if the battery is almost empty, else None.

    0 V and NaN stand for a missing measurement and are not refused.
    """
    bound = parameters["BAT_EMPTY_V"] + BATTERY_LOW_CELL_V * parameters["BAT_CELLS"]
    if not 0.0 < battery_v < bound:
        return None
    text = f"battery at {battery_v:.2f} V, below {bound:.2f} V"
    return _refused(ReferenceReason.BATTERY, text, battery_v, bound)


def _check_reference(blob: Reference, parameters: ParameterValues, battery_v: float) -> Verdict:
    limits = parameters.limits
    low, high = limits.thrust_headroom
    available = high
    if battery_v > 0.0:
        full = (battery_v / parameters["BAT_FULL_V"]) ** 2  # thrust goes with the square of the voltage
        available = max(low + 1e-6, min(high, (1.0 - BATTERY_RESERVE) * full))
    result = check_reference(
        blob.nodes,
        blob.yaw_nodes(),
        parameters.airframe,
        replace(limits, thrust_headroom=(low, available)),
        origin=blob.origin_ned,
        ends_at_rest=not blob.free_ends,
    )
    if result.ok:
        return Verdict(ok=True)
    reason, text = result.reason_code, result.text
    if reason is ReferenceReason.THRUST_HIGH and result.bound < high:
        reason = ReferenceReason.BATTERY
        text = f"{result.quantity} {result.value:.4g} of max, the battery gives {result.bound:.4g}"
    return Verdict(
        ok=False,
        node=result.node if 0 <= result.node < 0xFFFF else None,
        reason=int(reason),
        value=result.value,
        bound=result.bound,
        message=text,
    )


def _check_feedforward(blob: FeedForward) -> Verdict:
    for name, values, low, high in _block_ranges(blob.block or NEUTRAL_BLOCK):
        for value in values:
            if not low <= value <= high:
                bound = low if value < low else high
                return _refused(
                    Reason.FEEDFORWARD_RANGE, f"{name} {value:.4g} beyond {bound:g}", value, bound
                )
    if blob.layers:
        accel = _greatest_network_output(blob)
        if not accel <= NETWORK_MAX:
            text = f"network gives {accel:.4g} m/s^2, beyond {NETWORK_MAX:g}"
            return _refused(Reason.FEEDFORWARD_RANGE, text, accel, NETWORK_MAX)
    return Verdict(ok=True)


def _block_ranges(block: Sequence[float]) -> tuple[tuple[str, Sequence[float], float, float], ...]:
    """Return name, values, lower and upper bound of every field of the block."""
    return (
        ("gain", block[law.GAIN : law.GAIN + 1], *GAIN_RANGE),
        ("bias", block[law.BIAS], -BIAS_MAX, BIAS_MAX),
        ("drag", (*block[law.LINEAR], *block[law.QUADRATIC]), -DRAG_MAX, DRAG_MAX),
        ("attitude offset", block[law.ATTITUDE_OFFSET], -OFFSET_MAX, OFFSET_MAX),
        ("prediction time", block[law.PREDICTION_TIME : law.PREDICTION_TIME + 1], 0.0, PREDICTION_MAX_S),
        ("wind", block[law.WIND], -WIND_MAX, WIND_MAX),
        (
            "voltage exponent",
            block[law.VOLTAGE_EXPONENT : law.VOLTAGE_EXPONENT + 1],
            -EXPONENT_MAX,
            EXPONENT_MAX,
        ),
    )


def _greatest_network_output(blob: FeedForward) -> float:
    """Return the greatest residual acceleration (m/s^2) of the network at rest and at its region's bounds.

    The samples are rest and the greatest speed in ten directions, level and at the greatest roll and pitch,
    at four headings.
    """
    speed, tilt = (NETWORK_SPEED, NETWORK_TILT) if blob.region is None else blob.region[:2]
    diagonal = math.sqrt(0.5)
    directions = [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    for n, e in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)):
        directions += [(n, e, 0.0), (diagonal * (n - e), diagonal * (n + e), 0.0)]
    attitudes = [(0.0, 0.0), (tilt, 0.0), (-tilt, 0.0), (0.0, tilt), (0.0, -tilt)]
    yaws = (0.0,) if blob.frame == "body" else (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi)
    greatest = 0.0
    for direction in directions:
        for roll, pitch in attitudes:
            for yaw in yaws:
                R = euler_to_matrix(FLOAT, (roll, pitch, yaw))
                v = tuple(speed * part for part in direction)
                motion = law.FlatMotion(v, _ZERO, R, _ZERO)
                residual = law.network_residual(
                    FLOAT, blob.weights, blob.layers, motion, body_frame=blob.frame == "body"
                )
                greatest = max(greatest, math.hypot(*residual.accel_ned))
    return greatest


def _refused(
    reason: Reason | ReferenceReason, message: str, value: float = 0.0, bound: float = 0.0
) -> Verdict:
    return Verdict(ok=False, reason=int(reason), value=value, bound=bound, message=message)
