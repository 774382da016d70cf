"""Other methods on the same logs: sparse regression in weak form, stepwise regression, a network alone.

The columns of both regressions are the library's effects, linearised at the nominal vehicle. Their data are
accelerations: measured specific force, and the derivative of the measured body rate, minus the nominal model
along the measured states. Effects on poses alone have no column, nor has wind without a drag.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from trimtab.host.effects import Effect, load_effects
from trimtab.host.log import Flight, read_flight
from trimtab.host.trace.data.cutting import DT_S, segments_of
from trimtab.host.trace.data.segments import Segments
from trimtab.host.trace.data.signals import FlightData, unknowns
from trimtab.host.trace.parameters import ParameterSpace, space
from trimtab.host.trace.segment_fit import rollout
from trimtab.host.trace.segment_fit.model import NUISANCES, SegmentModel
from trimtab.host.vehicle import Vehicle, load_vehicle
from trimtab.sitl.studies.commandline import run_apart
from trimtab.sitl.studies.files import StudyError, read_json, write_json
from trimtab.sitl.studies.flights import SCORE, TRUTH, Programme
from trimtab.sitl.studies.scoring.names import collapsed, effect_of

BASELINES = "baselines.json"
RUN_S = 0.1
"""Duration of the pieces of flight that the regressions compare, each from the measured state."""

WINDOW_S = 0.4
THRESHOLD = 0.25
"""Typical sizes below which a term of the sparse regression is dropped."""

BIC_GAIN = 10.0
"""Minimum gain of the information criterion for another effect."""

MOST_EFFECTS = 6
LEAST = 0.05
"""Root mean square of a column, over nominal turbulence, below which flights do not show it."""

_SCALE = np.array([0.04] * 3 + [0.5] * 3)
_STEP = 1e-4


def judge_others(folder: Path, programme: Programme) -> dict[str, Any]:
    """Apply the other methods to a scored world, and return and store their results.

    For each method: names (None if it names nothing), whether the first name and the set are correct, and the
    error on held-out flights, m, if the method predicts. Raises StudyError if there is no score yet or
    PySINDy is not installed.
    """
    if (folder / BASELINES).is_file():
        return read_json(folder / BASELINES)
    if not (folder / SCORE).is_file():
        raise StudyError(f"world {folder.name}: other methods can run only after the world is scored")
    truth = read_json(folder / TRUTH)
    kinds, vehicle = truth["kinds"], load_vehicle(truth["vehicle"])
    effects = load_effects()
    chosen = space(vehicle, effects)
    used = programme.logs(programme.learning)
    series = _series(vehicle, chosen, [read_flight(folder / "flights" / log) for log in used])
    found = {"weak SINDy": weak_sindy(chosen, series), "stepwise BIC": stepwise_bic(chosen, series)}
    brought = frozenset(read_json(folder / SCORE)["brought"])
    judged = {method: _judged(names, kinds, effects, brought) for method, names in found.items()}
    error = _network(folder / "flights", used, programme.logs(programme.held_out))
    judged["network alone"] = {"names": None, "first_right": None, "exact": None, "after_m": error}
    write_json(folder / BASELINES, judged)
    return judged


def _judged(
    names: list[str], kinds: Sequence[str], effects: Mapping[str, Effect], brought: frozenset[str]
) -> dict[str, Any]:
    """Compare names, the strongest first, with the truth, by the rules for our verdicts."""
    names = list(dict.fromkeys(map(effect_of, names)))
    truth, counted = collapsed(kinds, kinds, effects), collapsed(names, kinds, effects, brought)
    return {
        "names": names,
        "first_right": bool(names) and collapsed(names[:1], kinds, effects) <= truth,
        "exact": bool(names) and counted == truth,
        "after_m": None,
    }


def _series(vehicle: Vehicle, space: ParameterSpace, flights: Sequence[Flight]) -> list[np.ndarray]:
    """Return residual accelerations and their slopes (n, 6, 1 + P) for each flight, every DT_S.

    Slopes are in scaled parameters. Channels are specific force and angular acceleration, FRD, over nominal
    turbulence.
    """
    data, _ = segments_of(
        [FlightData.of(flight) for flight in flights],
        rate_driven="torque" in unknowns(flights),
        segment_s=RUN_S,
    )
    count = len(space.columns)
    lanes = np.zeros((count, 1 + count))
    lanes[np.arange(count), 1 + np.arange(count)] = _STEP
    out = _responses(vehicle, space, data, lanes)
    slopes = (out[1:] - out[0]) / _STEP
    slopes[..., 3:] = np.gradient(slopes[..., 3:], DT_S, axis=2)
    turning = np.gradient(out[0][..., 3:], DT_S, axis=1)
    found = []
    for flight in range(len(flights)):
        mine = np.flatnonzero(data.flight == flight)
        mine = mine[np.argsort(data.start_s[mine])]
        force = (data.force_frd[mine] - out[0][mine][..., :3]).reshape(-1, 3)
        rate = np.gradient(data.rate_frd[mine].reshape(-1, 3), DT_S, axis=0) - turning[mine].reshape(-1, 3)
        rest = np.concatenate([force, rate], axis=1)
        terms = np.moveaxis(slopes[:, mine].reshape(count, -1, 6), 0, 2)
        found.append(np.concatenate([rest[:, :, None], terms], axis=2) / _SCALE[:, None])
    return found


def _shown(space: ParameterSpace, series: Sequence[np.ndarray]) -> list[str]:
    """Return the candidates that exceed LEAST at their typical size (not the sag of a full battery)."""
    rms = np.sqrt(np.mean([(s[:, :, 1:] ** 2).mean((0, 1)) for s in series], axis=0))
    return [name for name in space.candidates if max(rms[i] for i in space.groups[name]) > LEAST]


def weak_sindy(
    space: ParameterSpace, series: Sequence[Annotated[np.ndarray, "samples 6 columns"]]
) -> list[str]:
    """Return the effects with a term in PySINDy's weak-form sparse regression, the greatest term first.

    Every channel of every flight is a trajectory of an integrated residual. The library's columns are its
    inputs, so all channels share the coefficients. Raises StudyError if PySINDy is not installed.
    """
    try:
        pysindy: Any = importlib.import_module("pysindy")
        base: Any = importlib.import_module("pysindy.feature_library.base")
    except ImportError:
        raise StudyError(
            "PySINDy is not installed; run `pip install pysindy` or leave out --baselines"
        ) from None

    class Inputs(base.BaseFeatureLibrary):
        """The unchanged inputs, without the state."""

        @base.x_sequence_or_item
        def fit(self, x_full: Any, y: Any = None) -> Inputs:
            self.n_features_in_ = x_full[0].shape[-1]
            self.n_output_features_ = self.n_features_in_ - 1
            return self

        @base.x_sequence_or_item
        def transform(self, x_full: Any) -> Any:
            return [x[..., 1:] for x in x_full]

        def get_feature_names(self, input_features: Any = None) -> list[str]:
            return [f"u{i}" for i in range(self.n_output_features_)]

    shown = _shown(space, series)
    columns = [i for name in shown for i in space.groups[name]]
    length = min(len(s) for s in series)
    time = DT_S * np.arange(length)
    state = [np.cumsum(s[:length, i, :1], axis=0) * DT_S for s in series for i in range(6)]
    inputs = [s[:length, i, 1:][:, columns] for s in series for i in range(6)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        np.random.seed(0)
        weak = pysindy.WeakPDELibrary(
            function_library=Inputs(),
            spatiotemporal_grid=time,
            K=round(2.0 * time[-1] / WINDOW_S),
            H_xt=[0.5 * WINDOW_S],
        )
        model = pysindy.SINDy(feature_library=weak, optimizer=pysindy.STLSQ(threshold=THRESHOLD, alpha=1e-3))
        model.fit(state, time, u=inputs)
    terms = dict(zip(columns, np.abs(model.coefficients()[0]).tolist(), strict=True))
    sizes = {name: max(terms[i] for i in space.groups[name]) for name in shown}
    return sorted((name for name in sizes if sizes[name] > 0.0), key=lambda name: -sizes[name])


def stepwise_bic(
    space: ParameterSpace, series: Sequence[Annotated[np.ndarray, "samples 6 columns"]]
) -> list[str]:
    """Return the effects that forward selection by the Bayesian information criterion adds, in that order.

    The regression is in weak form: means over bump-weighted windows that overlap by half.
    """
    width = round(WINDOW_S / DT_S)
    bump = (1.0 - np.linspace(-1.0, 1.0, width) ** 2) ** 4
    bump /= bump.sum()
    parts = [
        np.einsum("t,tij->ij", bump, s[k : k + width])
        for s in series
        for k in range(0, len(s) - width, width // 2)
    ]
    rows = np.concatenate(parts)
    b, A = rows[:, 0], rows[:, 1:]

    def criterion(names: Sequence[str]) -> float:
        columns = [i for name in names for i in space.groups[name]]
        rest = b - A[:, columns] @ np.linalg.lstsq(A[:, columns], b, rcond=None)[0] if columns else b
        return len(b) * float(np.log(rest @ rest / len(b))) + len(columns) * float(np.log(len(b)))

    chosen: list[str] = []
    shown = _shown(space, series)
    here = criterion(chosen)
    while len(chosen) < MOST_EFFECTS:
        free = [name for name in shown if name not in chosen]
        best, name = min(((criterion([*chosen, name]), name) for name in free), default=(here, ""))
        if best > here - BIC_GAIN:
            break
        chosen.append(name)
        here = best
    return chosen


def _network(folder: Path, used: Sequence[str], held_out: Sequence[str]) -> float | None:
    """Return the position error, m, of the paper's network alone on held-out flights; None if it failed."""
    words = ["learn", *used, "--hold-out", *held_out, "-o", "network.model.toml", "--force"]
    done = run_apart(words, folder)
    for path in folder.glob("network.model.*"):
        path.unlink()
    return (done.data.get("test") or {}).get("position_rmse_m") if done.code == 0 else None


def _responses(vehicle: Vehicle, space: ParameterSpace, data: Segments, z: np.ndarray) -> np.ndarray:
    """Return specific force and body rate (batch, S, H, 6), FRD, of the effects at scaled z (P, batch).

    They are means over the steps of the data, from its states under its motor commands.
    """
    lanes = z.shape[1]
    x0 = np.repeat(data.x0.T[:, None, :], lanes, axis=1)
    nuisances = np.zeros((NUISANCES, lanes, len(data.flight)))
    form = SegmentModel.of(vehicle, space, data)
    found = rollout.roll_out(form, data, x0, z, nuisances)
    return np.transpose(found[:, [9, 10, 11, 6, 7, 8]], (2, 3, 0, 1))
