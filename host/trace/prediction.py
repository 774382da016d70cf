"""Prediction error before and after, on flights that were not used.

Where a log has its reference and the law is known, the whole flight is predicted from the reference alone
(`reference`); otherwise 0.6 s from the recorded inputs, with the initial state fitted to the time before
(`inputs`). Before and after are treated identically.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trimtab.host.codegen.ops import NUMPY
from trimtab.host.effects import Effect
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.model import Model
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import half_steps, reference_drive, roll_out
from trimtab.host.models.slots import mocap_latency_s as latency_of
from trimtab.host.models.states import flight_states
from trimtab.host.trace import evidence
from trimtab.host.trace.data.cutting import DT_S, SEGMENT_S, segments_of
from trimtab.host.trace.data.logs import TraceData
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData, pose_interval_s
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.segment_fit import linearise, rollout
from trimtab.host.trace.segment_fit.fit import starting_process
from trimtab.host.trace.segment_fit.model import LOCALS, SegmentModel

_LEAD_S = 0.3
_ROLL_OUT_STEP_S = 0.005


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Prediction errors of one flight: at times t_s (n,).

    p_error_ned (n, 3) m and v_error_ned (n, 3) m/s, measured less predicted; p_predicted_ned,
    p_measured_ned.
    """

    flight: str
    reference_id: str | None
    t_s: np.ndarray
    p_error_ned: np.ndarray
    v_error_ned: np.ndarray
    p_predicted_ned: np.ndarray
    p_measured_ned: np.ndarray


def rmse(errors: Sequence[Errors]) -> dict[str, float]:
    """Root mean square of the norm of the errors of all flights."""
    p = np.concatenate([e.p_error_ned for e in errors])
    v = np.concatenate([e.v_error_ned for e in errors])
    return {
        "position_rmse_m": float(np.sqrt((p**2).sum(1).mean())),
        "velocity_rmse_m_s": float(np.sqrt((v**2).sum(1).mean())),
    }


def motion(data: FlightData) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured times (n,) s, positions and velocities (n, 3) in the used span, by local quadratics over 0.1 s
    or, where poses are rare, over seven of them.
    """
    s = data.signals
    half_s = max(0.055, 3.5 * pose_interval_s(s))
    t = np.arange(s.span_s[0] + half_s + 0.005, s.span_s[1] - half_s - 0.005, DT_S)
    low, high = np.searchsorted(s.pose_s, t - half_s), np.searchsorted(s.pose_s, t + half_s)
    good = high - low >= 6
    t, low, high = t[good], low[good], high[good]
    if not len(t):
        return t, np.empty((0, 3)), np.empty((0, 3))
    near = low[:, None] + np.arange((high - low).max())
    inside = near < high[:, None]
    near = np.minimum(near, len(s.pose_s) - 1)
    # Times in units of the window, so that the powers are of one size.
    x = (s.pose_s[near] - t[:, None]) / half_s
    powers = np.stack([np.ones_like(x), x, x * x], axis=2) * inside[:, :, None]
    normal = np.swapaxes(powers, 1, 2) @ powers
    fit = np.linalg.solve(normal, np.swapaxes(powers, 1, 2) @ s.p_ned[near])
    return t, fit[:, 0], fit[:, 1] / half_s


def predict_flights(
    flights: Sequence[FlightData], model: Model | None, effects: Mapping[str, Effect]
) -> tuple[Errors, ...]:
    """Errors of whole flights predicted from their references by phi with the model's effects.

    Flights of one firmware setting are rolled out together.
    """
    settings: dict[str, list[int]] = {}
    for index, data in enumerate(flights):
        settings.setdefault(json.dumps(data.flight.firmware_parameters, sort_keys=True), []).append(index)
    found: dict[int, Errors] = {}
    for indices in settings.values():
        predicted = _predict([flights[index] for index in indices], model, effects)
        found.update(zip(indices, predicted, strict=True))
    return tuple(found[index] for index in range(len(flights)))


def _predict(data: Sequence[FlightData], model: Model | None, effects: Mapping[str, Effect]) -> list[Errors]:
    """Errors of flights of one firmware setting."""
    flights = [each.flight for each in data]
    parts = [] if model is None else model.parts(effects)
    phi = Phi(
        vehicle=flights[0].vehicle,
        effects=tuple(effect for effect, _ in parts),
        parameters=flights[0].firmware_parameters,
    )
    latency = float(latency_of(NUMPY, parts))
    known = flight_states(flights, latency_s=latency)
    duration = [states.reference.nodes[-1].t_us * 1e-6 for states in known]
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
        for states in known
    ]
    rolled = roll_out(
        phi,
        x0=np.stack([states.initial(phi) for states in known], axis=1),
        drive=np.stack(drives, axis=2),
        flight=np.stack([states.constants for states in known], axis=1),
        theta=phi.theta(parts),
        step_s=_ROLL_OUT_STEP_S / fine,
        every=fine,
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
        at = np.column_stack([np.interp(t - latency, grid, rolled[:, i, k]) for i in range(6)])
        out.append(
            Errors(
                flight=flight.id,
                reference_id=flight.reference_id,
                t_s=t,
                p_error_ned=p - at[:, :3],
                v_error_ned=v - at[:, 3:6],
                p_predicted_ned=at[:, :3],
                p_measured_ned=p,
            )
        )
    return out


def predict_segments(
    flights: Sequence[FlightData], segment_model: SegmentModel, theta_scaled: np.ndarray
) -> tuple[Errors, ...]:
    """Errors over 0.6 s ahead from recorded inputs, each start fitted to the 0.3 s before it.

    A flight's own nuisances come from its first quarter, and what is predicted lies behind that: nothing of a
    prediction knows what is measured later. Raises TooLittleData where nothing lies behind.
    """
    whole, _ = segments_of(flights, rate_driven=segment_model.rate_driven)
    data, _ = segments_of(flights, rate_driven=segment_model.rate_driven, segment_s=_LEAD_S + SEGMENT_S)
    spans = np.array([each.signals.span_s for each in flights])
    known_s = RULES.calibration_share * (spans[:, 1] - spans[:, 0])
    early = whole.take(whole.start_s + SEGMENT_S <= known_s[whole.flight])
    local = _fitted_local(segment_model, early, theta_scaled, len(flights))
    data = data.take(data.start_s >= known_s[data.flight])
    for index, each in enumerate(flights):
        if not (data.flight == index).any():
            raise TooLittleData(
                f"{each.flight.path}: too short to be held out; fly longer or hold out another"
            )
    lead = round(_LEAD_S / DT_S)
    before = (np.arange(data.steps) < lead).astype(float)
    fit = replace(
        data,
        pose_weight=data.pose_weight * before,
        rate_weight=data.rate_weight * before,
        force_weight=data.force_weight * before,
    )
    kept = linearise.basis(segment_model, fit, theta_scaled, local)
    x0 = linearise.fitted_x0(segment_model, fit, theta_scaled, local, kept, iterations=4)
    rolled = rollout.roll_out(
        segment_model, data, x0.T[:, None, :], theta_scaled[:, None], local[data.flight].T[:, None, :]
    )
    predicted = np.transpose(rolled[:, :3, 0, :], (2, 0, 1))
    speed = np.gradient(predicted, DT_S, axis=1)
    seen = data.pose_weight > 0
    seen[:, :lead] = False
    out = []
    for index, each in enumerate(flights):
        t, p, v = motion(each)
        mine = seen & (data.flight == index)[:, None]
        grid = data.start_s[:, None] + spans[index, 0] + DT_S * np.arange(data.steps)
        # A prediction is of its pose's own time; its slope along the grid is the speed at the grid's.
        ahead, steps = (grid + data.shift_s)[mine], grid[mine]
        measured = np.column_stack([np.interp(ahead, t, p[:, i]) for i in range(3)])
        velocity = np.column_stack([np.interp(steps, t, v[:, i]) for i in range(3)])
        out.append(
            Errors(
                flight=each.flight.id,
                reference_id=each.flight.reference_id,
                t_s=ahead,
                p_error_ned=measured - predicted[mine],
                v_error_ned=velocity - speed[mine],
                p_predicted_ned=predicted[mine],
                p_measured_ned=measured,
            )
        )
    return tuple(out)


def _fitted_local(
    segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray, flights: int
) -> np.ndarray:
    """Nuisances (flights, 9) of flights that were not used, under given parameters; 0 where no segment is."""
    local = np.zeros((flights, LOCALS))
    if not len(data.flight):
        return local
    process = starting_process(data)
    kept = linearise.basis(segment_model, data, theta_scaled, local)
    for _ in range(3):
        grams = linearise.linearise(segment_model, data, theta_scaled, local, kept)
        data = data.with_x0(grams.x0)
        lin = linearise.project(grams, data, theta_scaled, local)
        process = evidence.fit_process(lin, segment_model.space.prior, (), process)
        white = evidence.whitened(lin, process, segment_model.space.prior)
        local = local + evidence.local_step(
            lin, white, segment_model.space.prior, np.zeros(len(theta_scaled))
        )
    return local


def noise_floor(
    logs: TraceData, model: Model | None, effects: Mapping[str, Effect]
) -> dict[str, float | None]:
    """Estimate the error that a perfect model would leave: what does not repeat between twins.

    Each flight is predicted whole, by one model; voltage and the like, which the model follows, drop out.
    None where nothing was flown twice or flights cannot be predicted whole.
    """
    whole = logs.drive == "reference" and logs.twins
    errors = predict_flights(logs.flights, model, effects) if whole else ()
    squares: dict[str, list[np.ndarray]] = {"p_error_ned": [], "v_error_ned": []}
    for a, b in logs.twins if errors else ():
        first, second = errors[a], errors[b]
        t = first.t_s[(first.t_s >= second.t_s[0]) & (first.t_s <= second.t_s[-1])]
        for kind, found in squares.items():
            for i in range(3):
                x, y = (np.interp(t, e.t_s, getattr(e, kind)[:, i]) for e in (first, second))
                found.append((x - y) ** 2)
    rms = {k: float(np.sqrt(1.5 * np.mean(np.concatenate(v)))) if v else None for k, v in squares.items()}
    return {"position_rmse_m": rms["p_error_ned"], "velocity_rmse_m_s": rms["v_error_ned"]}
