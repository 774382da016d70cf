"""Prediction errors on held-out flights, without and with the selected effects.

If all logs hold a reference and the control law, whole flights are predicted from their references alone
(drive `reference`). Otherwise the next 0.6 s are predicted from the recorded inputs, with the initial state
fitted to the 0.3 s before (drive `inputs`). Both models are treated identically.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from trimtab.host.base import parallel
from trimtab.host.codegen.ops import NUMPY
from trimtab.host.effects import Effect
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.airframe import Part
from trimtab.host.models.model import Model
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.slots import mocap_latency_s as latency_of
from trimtab.host.trace import evidence
from trimtab.host.trace.data.cutting import DT_S, SEGMENT_S, segments_of
from trimtab.host.trace.data.logs import TraceData
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData, local_quadratics, pose_interval_s, states_of
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.segment_fit import linearise, rollout
from trimtab.host.trace.segment_fit.fit import starting_process
from trimtab.host.trace.segment_fit.model import SegmentModel

_LEAD_S = 0.3
_ROLL_OUT_STEP_S = 0.005
_TOGETHER = 8
"""Flights that are rolled out together."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Prediction errors of one flight at times t_s in s.

    flight: id of the log. reference_id: id of its reference. p_error_ned in m and v_error_ned in m/s:
    measured minus predicted, NED. p_predicted_ned: position in m, NED.
    """

    flight: str
    reference_id: str | None
    t_s: Annotated[np.ndarray, "times"]
    p_error_ned: Annotated[np.ndarray, "times 3"]
    v_error_ned: Annotated[np.ndarray, "times 3"]
    p_predicted_ned: Annotated[np.ndarray, "times 3"]


def rmse(errors: Sequence[Errors]) -> dict[str, float]:
    """Return the root mean square norm of the position and velocity errors of all flights, m and m/s."""
    p = np.concatenate([e.p_error_ned for e in errors])
    v = np.concatenate([e.v_error_ned for e in errors])
    return {
        "position_rmse_m": float(np.sqrt((p**2).sum(1).mean())),
        "velocity_rmse_m_s": float(np.sqrt((v**2).sum(1).mean())),
    }


def motion(
    data: FlightData,
) -> tuple[
    Annotated[np.ndarray, "times"], Annotated[np.ndarray, "times 3"], Annotated[np.ndarray, "times 3"]
]:
    """Return times in s since arming, positions in m and velocities in m/s, NED.

    They come from local quadratics through the poses of the tracking phase, over windows of 0.11 s or, at
    low pose rates, of seven pose intervals.
    """
    s = data.signals
    half_s = max(0.055, 3.5 * pose_interval_s(s))
    t = np.arange(s.span_s[0] + half_s + 0.005, s.span_s[1] - half_s - 0.005, DT_S)
    low, high = np.searchsorted(s.pose_s, t - half_s), np.searchsorted(s.pose_s, t + half_s)
    enough = high - low >= 6
    t, low, high = t[enough], low[enough], high[enough]
    if not len(t):
        return t, np.empty((0, 3)), np.empty((0, 3))
    fit = local_quadratics(s, t, low, high, half_s)
    return t, fit[:, 0], fit[:, 1]


def predict_flights(
    flights: Sequence[FlightData], model: Model | None, effects: Mapping[str, Effect], *, jobs: int = 1
) -> tuple[Errors, ...]:
    """Return the errors of whole flights, predicted from their references by phi with the model.

    The model's effects, adjustments and network act. model: None for the nominal model. jobs: threads.
    Flights with the same firmware parameters are rolled out together, _TOGETHER at a time.
    """
    settings: dict[str, list[int]] = {}
    for index, data in enumerate(flights):
        settings.setdefault(json.dumps(data.flight.firmware_parameters, sort_keys=True), []).append(index)
    parts = [] if model is None else model.parts(effects)
    network = None if model is None else model.network
    batches = []
    for indices in settings.values():
        first = flights[indices[0]].flight
        phi = Phi(
            vehicle=first.vehicle,
            effects=tuple(effect for effect, _ in parts),
            parameters=first.firmware_parameters,
        )
        batches += [(phi, indices[k : k + _TOGETHER]) for k in range(0, len(indices), _TOGETHER)]

    def predict(batch: tuple[Phi, list[int]]) -> list[Errors]:
        phi, indices = batch
        return _predict(phi, [flights[index] for index in indices], parts, network)

    predicted = parallel.each(predict, batches, jobs)
    errors = {
        index: each
        for (_, indices), batch in zip(batches, predicted, strict=True)
        for index, each in zip(indices, batch, strict=True)
    }
    return tuple(errors[index] for index in range(len(flights)))


def _predict(
    phi: Phi, data: Sequence[FlightData], parts: Sequence[Part], network: Network | None
) -> list[Errors]:
    """Return the errors of flights that all have the firmware parameters of phi."""
    flights = [each.flight for each in data]
    latency = float(latency_of(NUMPY, parts))
    starts = states_of(data, latency)
    duration = [states.reference.nodes[-1].t_us * 1e-6 for states in starts]
    steps = round(max(duration) / _ROLL_OUT_STEP_S)
    fine = phi.substeps(_ROLL_OUT_STEP_S)
    stages = half_steps(0.0, steps * fine, _ROLL_OUT_STEP_S / fine)
    drives = [
        reference_drive(
            states.reference,
            stages,
            feedforward=states.feedforward,
            voltage_ratio=np.interp(stages, states.t_s, states.voltage_ratio),
        )
        for states in starts
    ]
    rolled = roll_out(
        phi,
        x0=np.stack([states.initial(phi) for states in starts], axis=1),
        drive=np.stack(drives, axis=2),
        flight=np.stack([states.constants for states in starts], axis=1),
        theta=phi.theta(parts),
        step_s=_ROLL_OUT_STEP_S / fine,
        every=fine,
        network=network,
        compiled=True,
    )
    grid = _ROLL_OUT_STEP_S * np.arange(steps + 1)
    out = []
    for k, flight in enumerate(flights):
        assert flight.tracking is not None
        t, p, v = motion(data[k])
        t = t - flight.tracking[0] * 1e-6
        inside = (t > 0.1) & (t < duration[k])
        t, p, v = t[inside], p[inside], v[inside]
        predicted = np.column_stack([np.interp(t - latency, grid, rolled[:, i, k]) for i in range(6)])
        out.append(
            Errors(
                flight=flight.id,
                reference_id=flight.reference_id,
                t_s=t,
                p_error_ned=p - predicted[:, :3],
                v_error_ned=v - predicted[:, 3:6],
                p_predicted_ned=predicted[:, :3],
            )
        )
    return out


def predict_segments(
    flights: Sequence[FlightData],
    segment_model: SegmentModel,
    theta_scaled: Annotated[np.ndarray, "parameters"],
) -> tuple[Errors, ...]:
    """Return the errors of predictions over 0.6 s from recorded inputs at theta_scaled.

    The initial state of each prediction is fitted to the 0.3 s before it. The nuisances of a flight are
    fitted to its first quarter (RULES.calibration_share), and predictions begin after that, so no prediction
    uses a later measurement. Raises TooLittleData if a flight has no segment after its first quarter.
    """
    whole, _ = segments_of(flights, rate_driven=segment_model.rate_driven)
    data, _ = segments_of(flights, rate_driven=segment_model.rate_driven, segment_s=_LEAD_S + SEGMENT_S)
    spans = np.array([each.signals.span_s for each in flights])
    calibration_s = RULES.calibration_share * (spans[:, 1] - spans[:, 0])
    early = whole.take(whole.start_s + SEGMENT_S <= calibration_s[whole.flight])
    nuisances = _fitted_nuisances(segment_model, early, theta_scaled, len(flights))
    data = data.take(data.start_s >= calibration_s[data.flight])
    for index, each in enumerate(flights):
        if not (data.flight == index).any():
            raise TooLittleData(
                f"{each.flight.path}: too short to hold out; fly longer or hold out another flight"
            )
    lead = round(_LEAD_S / DT_S)
    in_lead = (np.arange(data.steps) < lead).astype(float)
    lead_data = replace(
        data,
        pose_weight=data.pose_weight * in_lead,
        rate_weight=data.rate_weight * in_lead,
        force_weight=data.force_weight * in_lead,
    )
    basis = linearise.basis(segment_model, lead_data, theta_scaled, nuisances)
    x0 = linearise.fitted_x0(segment_model, lead_data, theta_scaled, nuisances, basis, iterations=4)
    rolled = rollout.roll_out(
        segment_model, data, x0.T[:, None, :], theta_scaled[:, None], nuisances[data.flight].T[:, None, :]
    )
    predicted = np.transpose(rolled[:, :3, 0, :], (2, 0, 1))
    # Predictions are those at the stamps of the poses, which need not be equidistant.
    stamp_s = data.start_s[:, None] + DT_S * np.arange(data.steps) + data.shift_s
    speed = np.stack([np.gradient(p, t, axis=0) for p, t in zip(predicted, stamp_s, strict=True)])
    posed = data.pose_weight > 0
    posed[:, :lead] = False
    out = []
    for index, each in enumerate(flights):
        t, p, v = motion(each)
        mask = posed & (data.flight == index)[:, None]
        pose_s = stamp_s[mask] + spans[index, 0]
        measured, velocity = (
            np.column_stack([np.interp(pose_s, t, axis) for axis in moved.T]) for moved in (p, v)
        )
        out.append(
            Errors(
                flight=each.flight.id,
                reference_id=each.flight.reference_id,
                t_s=pose_s,
                p_error_ned=measured - predicted[mask],
                v_error_ned=velocity - speed[mask],
                p_predicted_ned=predicted[mask],
            )
        )
    return tuple(out)


def _fitted_nuisances(
    segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray, flights: int
) -> np.ndarray:
    """Return the nuisances (flights, nuisances) of held-out flights at theta_scaled; 0 without segments.

    data: segments of the flights. flights: number of flights.
    """
    nuisances = np.zeros((flights, segment_model.nuisances))
    if not len(data.flight):
        return nuisances
    prior, process = segment_model.space.prior, starting_process(data)
    fixed = np.zeros(len(theta_scaled))
    basis = linearise.basis(segment_model, data, theta_scaled, nuisances)
    for _ in range(3):
        lin, x0 = linearise.linearise(segment_model, data, theta_scaled, nuisances, basis)
        data = data.with_x0(x0)
        lin, process, white = evidence.fit_noise(lin, prior, (), process, lambda _: fixed)
        nuisances = nuisances + evidence.nuisance_step(lin, white, prior, fixed)
    return nuisances


def noise_floor(
    logs: TraceData, model: Model | None, effects: Mapping[str, Effect], *, jobs: int
) -> dict[str, float | None]:
    """Return an estimate of the prediction error of a perfect model, from differences of repeat flights.

    It is the part of the errors of whole flights that does not repeat. One model predicts all flights, so
    known differences between flights, such as the battery voltage, drop out. The entries, in m and m/s, are
    None without repeat flights or if flights cannot be predicted whole. jobs: threads.
    """
    whole = logs.drive == "reference" and logs.repeat_flights
    errors = predict_flights(logs.flights, model, effects, jobs=jobs) if whole else ()
    squares: dict[str, list[np.ndarray]] = {"p_error_ned": [], "v_error_ned": []}
    for a, b in logs.repeat_flights if errors else ():
        first, second = errors[a], errors[b]
        t = first.t_s[(first.t_s >= second.t_s[0]) & (first.t_s <= second.t_s[-1])]
        for field, differences in squares.items():
            for i in range(3):
                x, y = (np.interp(t, e.t_s, getattr(e, field)[:, i]) for e in (first, second))
                differences.append((x - y) ** 2)
    rms = {k: float(np.sqrt(1.5 * np.mean(np.concatenate(v)))) if v else None for k, v in squares.items()}
    return {"position_rmse_m": rms["p_error_ned"], "velocity_rmse_m_s": rms["v_error_ned"]}
