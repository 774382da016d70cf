"""Build small inputs for the tests of tracing's decisions.

Each builder returns a valid value with neutral defaults, so that a test states only what it is about. Nothing
here flies, reads a log or fits a model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.host.effects import Closing, Effect, ExactAlias
from trimtab.host.effects.effect import Signal
from trimtab.host.effects.parameter import Parameter
from trimtab.host.log import Battery, Flight, Mocap
from trimtab.host.log.contents import LogContents
from trimtab.host.models.model import Model
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.decision.decide import DecisionInputs
from trimtab.host.trace.decision.findings import Verdict
from trimtab.host.trace.flight_fit.fit import FlightFit
from trimtab.host.trace.flight_fit.whitening import CHANNELS, Whitening
from trimtab.host.trace.linearisation import DisturbanceVariances, Linearisation
from trimtab.host.trace.parameters import Column, ParameterSpace
from trimtab.host.trace.residual.unexplained import (
    NO_LINE,
    ChannelResidual,
    FlightRepeat,
    SpectralLine,
    UnexplainedResidual,
)
from trimtab.host.trace.result import Named, Trace
from trimtab.host.trace.search import Names, SearchResult, null_probability_of
from trimtab.host.trace.segment_fit.fit import SegmentFit
from trimtab.host.trace.segment_fit.linearise import Basis
from trimtab.host.trace.segment_fit.model import NUISANCES, STATES
from trimtab.host.trace.selection import Diagnosis, Method
from trimtab.host.vehicle import Vehicle, load_vehicle

VEHICLE = load_vehicle("research")
MASS = "mass"
"""An effect that is an adjustment in every model."""


def build_parameter(
    key: str = "size",
    *,
    neutral: float = 0.0,
    typical: float = 1.0,
    tolerance: float = 0.1,
    strength: bool = True,
    measured_below: float | None = None,
) -> Parameter:
    """Return a parameter that may move by a hundred typical sizes."""
    return Parameter(
        key=key,
        unit="1",
        neutral=neutral,
        typical=typical,
        tolerance=tolerance,
        lower=neutral - 100.0 * typical,
        upper=neutral + 100.0 * typical,
        description="a number",
        strength=strength,
        measured_below=measured_below,
    )


def build_effect(
    name: str,
    *parameters: Parameter,
    aliases: Sequence[str] = (),
    requires_any: Sequence[str] = (),
    one_of: bool = False,
    noise_dependent: bool = False,
    memory: int = 0,
    exact_aliases: Sequence[ExactAlias] = (),
    needs_signals: Mapping[Signal, float] | None = None,
) -> Effect:
    """Return an effect that is a factor on the mass; with `memory` it adds states.

    The effect named MASS is an adjustment.
    """
    own: dict[str, Any] = {}
    if memory:
        own = {
            "memory": memory,
            "memory_start": lambda ops, theta, context: (0.0,) * memory,
            "memory_rates": lambda ops, theta, context: (0.0,) * memory,
        }
    return Effect(
        name=name,
        equation="m = m_nominal",
        source="a test",
        parameters=parameters or (build_parameter(),),
        closing=Closing(model="a factor", planner="nothing", law=None),
        aliases=tuple(aliases),
        requires_any=tuple(requires_any),
        noise_dependent=noise_dependent,
        one_of=one_of,
        exact_aliases=tuple(exact_aliases),
        needs_signals=needs_signals or {},
        adjustment=name == MASS,
        mass_factor=lambda ops, theta: 1.0,
        **own,
    )


def build_space(*effects: Effect | str) -> ParameterSpace:
    """Return the space of these effects (a name stands for a plain effect); all but the mass are candidates.

    A column's scale and tolerance are its parameter's typical size and tolerance.
    """
    known = [build_effect(each) if isinstance(each, str) else each for each in effects]
    columns = tuple(
        Column(
            owner=effect.name,
            key=p.key,
            unit=p.unit,
            neutral=p.neutral,
            scale=p.typical,
            tolerance=p.tolerance,
            lower=p.lower,
            upper=p.upper,
            strength=p.strength,
            form=p.form,
        )
        for effect in known
        for p in effect.parameters
    )
    owned = {"columns": columns, "effects": {effect.name: effect for effect in known}}
    groups = ParameterSpace(**owned, candidates=(), freed=(), nuisance_sigma=(1.0,) * NUISANCES).groups
    candidates = tuple(name for name in groups if name != MASS)
    return ParameterSpace(**owned, candidates=candidates, freed=(), nuisance_sigma=(1.0,) * NUISANCES)


def build_segments(*, rate_driven: bool = False) -> Segments:
    """Return one segment of one bin, at rest."""
    one = (1, 2)
    return Segments(
        dt_s=0.05,
        flight=np.zeros(1, dtype=int),
        start_s=np.zeros(1),
        x0=np.zeros((1, STATES)),
        p_ned=np.zeros((*one, 3)),
        R_ned_frd=np.tile(np.eye(3).ravel(), (*one, 1)),
        shift_s=np.zeros(one),
        pose_weight=np.ones(one),
        rate_frd=np.zeros((*one, 3)),
        rate_weight=np.ones(one),
        force_frd=np.zeros((*one, 3)),
        force_weight=np.ones(one),
        command=np.zeros((1, 3, 4)),
        voltage_ratio=np.ones(one),
        sigma=np.ones((1, 4)),
        disturbance_frd=np.zeros((1, 1, 6)),
        path_start_s=np.zeros(1),
        paths=np.zeros((1, 2, STATES)),
        in_newton=False,
        rate_driven=rate_driven,
    )


def build_fit(
    effects: Names = (),
    *,
    log_evidence: float = 0.0,
    theta_scaled: Sequence[float] = (),
    covariance: np.ndarray | None = None,
    lateral: float = 0.01,
    axial: float = 0.01,
    angular: float = 0.01,
    rate_driven: bool = False,
) -> SegmentFit:
    """Return a fit to one segment that leaves the given disturbance.

    theta_scaled (P,) and covariance (P, P) are scaled; `lateral` and `axial` in m/s^2, `angular` in rad/s^2.
    """
    count, data = len(theta_scaled), build_segments(rate_driven=rate_driven)
    logs = {"lateral": lateral, "axial": axial, "torque": angular}
    return SegmentFit(
        effects=effects,
        log_evidence=log_evidence,
        theta_scaled=np.array(theta_scaled, dtype=float),
        nuisances=np.zeros((1, NUISANCES)),
        covariance=np.eye(count) if covariance is None else covariance,
        process=DisturbanceVariances(
            **{f"log_{name}": float(2.0 * np.log(sigma)) for name, sigma in logs.items()}
        ),
        lin=Linearisation(
            own=np.zeros((1, 1 + count + NUISANCES, 1 + count + NUISANCES)),
            square=np.zeros((1, 6, 6)),
            cross=np.zeros((1, 6, 1 + count + NUISANCES)),
            piece=np.zeros(1, dtype=int),
            piece_flight=np.zeros(1, dtype=int),
            theta_scaled=np.array(theta_scaled, dtype=float),
            nuisances=np.zeros((1, NUISANCES)),
        ),
        data=data,
        basis=Basis(
            theta_scaled=np.array(theta_scaled, dtype=float),
            nuisances=np.zeros((1, NUISANCES)),
            x0=data.x0,
            disturbance_frd=data.disturbance_frd,
            memory=np.zeros((0, 1, 1)),
        ),
    )


def build_closed_fit(
    effects: Names = (),
    *,
    log_evidence: float = 0.0,
    theta_scaled: Sequence[float] = (),
    covariance: np.ndarray | None = None,
    grams: np.ndarray | None = None,
) -> FlightFit:
    """Return a fit to one whole flight; theta_scaled (P,), covariance (P, P), grams (1, 1 + P, 1 + P)."""
    count = len(theta_scaled)
    return FlightFit(
        effects=effects,
        theta_scaled=np.array(theta_scaled, dtype=float),
        at=np.zeros(count),
        covariance=np.eye(count) if covariance is None else covariance,
        log_evidence=log_evidence,
        whitening=Whitening(coefficients=np.zeros((CHANNELS, CHANNELS)), innovation=np.eye(CHANNELS)),
        grams=np.ones((1, 1 + count, 1 + count)) if grams is None else grams,
        error_m=0.01,
    )


def build_search_result(
    selected: Any,
    *,
    log_evidence: Mapping[Names, float] | None = None,
    posterior_weights: Mapping[Names, float] | None = None,
) -> SearchResult[Any]:
    """Return the result of a search; by default every fitted set may be selected."""
    fitted = {selected.effects: selected.log_evidence} if log_evidence is None else log_evidence
    posterior_weights = dict.fromkeys(fitted, 1.0) if posterior_weights is None else posterior_weights
    return SearchResult(
        selected=selected, inclusion_probability={}, posterior_weights=posterior_weights, log_evidence=fitted
    )


def build_diagnosis(
    effects: Names = (),
    *,
    posterior_weights: Mapping[Names, float] | None = None,
    inclusion_probability: Mapping[str, float] | None = None,
    detectability: Mapping[str, float] | None = None,
    selected: SegmentFit | None = None,
    method: Method = "segments",
    repeatability: tuple[FlightRepeat | None, FlightRepeat | None] = (None, None),
) -> Diagnosis:
    """Return a diagnosis that selects `effects`, by default with certainty."""
    return Diagnosis(
        selected=selected or build_fit(effects),
        null_fit=build_fit(),
        method=method,
        inclusion_probability=inclusion_probability or {},
        posterior_weights={effects: 1.0} if posterior_weights is None else posterior_weights,
        log_evidence={},
        detectability=detectability or {},
        repeatability=repeatability,
    )


def weights_of_nothing(probability: float, other: Names = ("other",)) -> dict[Names, float]:
    """Return weights under which no effect is missing with this probability, to the bit."""
    weights = {(): probability, other: 1.0 - probability}
    assert null_probability_of(weights) == probability
    return weights


def build_flight_repeat(
    *, share: float = 0.0, z_score: float = 0.0, position_m: float = 0.0, size: int = 1000
) -> FlightRepeat:
    """Return the repeatability of whole flights; by default nothing repeats."""
    return FlightRepeat(share=share, z_score=z_score, position_m=position_m, size=size)


def build_channel(
    *, repeat: float = 0.0, z_score: float = 0.0, line: SpectralLine = NO_LINE
) -> ChannelResidual:
    """Return a residual force (m/s^2) or torque (rad/s^2); by default there is none."""
    return ChannelResidual(repeat=repeat, z_score=z_score, line=line)


def build_residual(
    *,
    force: ChannelResidual | None = None,
    torque: ChannelResidual | None = None,
    pairs: int = 1,
    flight_repeat: FlightRepeat | None = None,
) -> UnexplainedResidual:
    """Return the residual of one pair of repeat flights; by default nothing is unexplained."""
    return UnexplainedResidual(
        force=force or build_channel(),
        torque=torque or build_channel(),
        pairs=pairs,
        flight_repeat=flight_repeat,
    )


LIBRARY = build_space("drag", "gain", "wind", "lag", "sag")
"""Five unrelated effects."""


def build_inputs(selected: Names = (), **changes: Any) -> DecisionInputs:
    """Return clear inputs for the effects `selected` from long repeat flights, except for `changes`."""
    clear: dict[str, Any] = {
        "space": LIBRARY,
        "null_probability": 0.0 if selected else 1.0,
        "log_evidence": {selected: 0.0},
        "posterior_weights": {selected: 1.0},
        "detectability": {},
        "by_segments": False,
        "closed_loop": True,
        "residual": build_residual(),
        "residual_without": build_residual(),
        "disturbance_sigma": (0.01,) * 6,
        "thrust_known": True,
        "rate_driven": False,
        "segment_disagreement_nats": {},
        "tracking_s": 60.0,
        "extent_m": 2.0,
        "pose_interval_s": 0.01,
    }
    probability = {**dict.fromkeys(selected, 1.0), **changes.pop("inclusion_probability", {})}
    return DecisionInputs(selected=selected, inclusion_probability=probability, **{**clear, **changes})


def build_flight(
    name: str = "one",
    *,
    vehicle: Vehicle = VEHICLE,
    reference_id: str | None = None,
    tracked_s: float = 10.0,
    extent_m: float = 1.0,
    elsewhere_m: float = 0.0,
    voltage_ratio: Sequence[float] | None = None,
    poses: int | None = None,
) -> Flight:
    """Return an imported flight of poses only, at 50 Hz, tracking from 1 s on.

    It moves north by `extent_m` while tracked and is `elsewhere_m` to the east before and after.
    `voltage_ratio`: battery voltage over full voltage, over the whole flight. `poses`: keep only so many.
    """
    start_s, end_s = 1.0, 1.0 + tracked_s
    t_us = np.arange(0, round(1e6 * (end_s + 1.0)) + 1, 20_000)
    t_s = t_us * 1e-6
    p = np.zeros((len(t_us), 3))
    p[:, 0] = np.interp(t_s, [start_s + 0.1, end_s - 0.1], [0.0, extent_m])
    p[(t_s < start_s) | (t_s > end_s), 1] = elsewhere_m
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(t_us), 1))
    at = slice(None, poses)
    battery = None
    if voltage_ratio is not None:
        volts = VEHICLE.battery.full_v * np.array(voltage_ratio)
        battery = Battery(t_us=np.arange(len(volts)) * 1_000_000, battery_v=volts)
    return Flight(
        id=name,
        path=Path(f"{name}.mcap"),
        kind="import",
        vehicle=vehicle,
        reference=None,
        reference_id=reference_id,
        feedforward=None,
        firmware_parameters=None,
        metadata={},
        mocap=Mocap(t_us=t_us[at], t_arrival_us=t_us[at], p=p[at], q=q[at]),
        estimate=None,
        control=None,
        observer=None,
        status=None,
        link=None,
        recorded_inputs=None,
        recorded_imu=None,
        battery=battery,
        tracking=(round(1e6 * start_s), round(1e6 * end_s)),
        tracking_whole=True,
        failsafe=None,
        duration_s=float(t_s[-1]),
        contents=LogContents(size=0, topics={}, recovered=False),
    )


def build_named(name: str) -> Named:
    """Return an effect that a trace names with certainty."""
    return Named(name=name, title=name, parameters={}, probability=1.0, aliases={}, exact_aliases={})


def build_trace(
    space: ParameterSpace, diagnosis: Diagnosis, *, named: Sequence[str] = (), **changes: Any
) -> Trace:
    """Return a trace that names these effects, without held-out flights, except for `changes`."""
    plain: dict[str, Any] = {
        "verdict": Verdict.TRACED if named else Verdict.NOTHING_MISSING,
        "findings": (),
        "effects": tuple(build_named(name) for name in named),
        "possible": {},
        "drive": "inputs",
        "before": (),
        "after": (),
        "adjustments_only": (),
        "noise_floor": {},
        "next_flight": None,
        "model": Model(vehicle_id=VEHICLE.id, vehicle_name=VEHICLE.name),
        "space": space,
        "diagnosis": diagnosis,
        "residual": build_residual(),
        "audits": (),
        "description": None,
        "unexplained": None,
    }
    return Trace(**{**plain, **changes})
