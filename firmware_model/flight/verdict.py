"""On-board check of a blob against the parameters and limits of the vehicle."""

from __future__ import annotations

from dataclasses import replace
from enum import IntEnum

from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.law.checks import ONE_BY_ONE, Evaluator, check_reference
from trimtab.firmware_model.law.feedforward import full_block
from trimtab.firmware_model.law.feedforward_range import out_of_range
from trimtab.firmware_model.law.reference_verdict import ReferenceReason
from trimtab.protocol.blobs import BlobError, FeedForward, Reference, from_bytes
from trimtab.protocol.upload import Verdict


class Reason(IntEnum):
    """Reasons of a refusal in addition to ReferenceReason (below 100). Part of the protocol."""

    BAD_BLOB = 100
    OTHER_VEHICLE = 101
    OTHER_KIND = 102
    FEEDFORWARD_RANGE = 103
    NOT_CONTINUOUS = 104  # jump from the present reference at the swap
    TOO_LATE = 105


BATTERY_RESERVE = 0.05
"""Share of the available thrust that a reference leaves for the controller and for further voltage sag."""
BATTERY_LOW_CELL_V = 0.1
"""Least cell voltage above empty at which a reference is accepted."""


def check_blob(
    kind: int,
    data: bytes,
    *,
    parameters: ParameterValues,
    vehicle_id: str,
    battery_v: float = 0.0,
    evaluator: Evaluator = ONE_BY_ONE,
) -> Verdict:
    """Return the verdict on a blob. Never raises.

    battery_v: last measured voltage; 0 without a measurement, which skips the check of the battery.
    evaluator: computes the samples of a reference; a simulator has a faster one with the same bits.
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
        return battery_verdict(parameters, battery_v) or _check_reference(
            blob, parameters, battery_v, evaluator
        )
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


def _check_reference(
    blob: Reference, parameters: ParameterValues, battery_v: float, evaluator: Evaluator
) -> Verdict:
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
        evaluator=evaluator,
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
    block = full_block(blob.block, blob.region)
    excess = out_of_range(block, blob.weights, blob.layers, body_frame=blob.body_frame)
    if excess is None:
        return Verdict(ok=True)
    text = f"{excess.quantity} {excess.value:.4g} beyond {excess.bound:g}"
    return _refused(Reason.FEEDFORWARD_RANGE, text, excess.value, excess.bound)


def _refused(
    reason: Reason | ReferenceReason, message: str, value: float = 0.0, bound: float = 0.0
) -> Verdict:
    return Verdict(ok=False, reason=int(reason), value=value, bound=bound, message=message)
