"""How well a model predicts flights, beside the nominal model of the same vehicle."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trimtab.host.base import parallel
from trimtab.host.base.errors import UsageError
from trimtab.host.compare.measure import MaybeErrors, measured_errors
from trimtab.host.compare.statistics import Difference, median_of, paired_difference, trend
from trimtab.host.effects import Effect, load_effects
from trimtab.host.log import Flight
from trimtab.host.log.provenance import date_text, utc_date
from trimtab.host.models.model import Model
from trimtab.host.trace.data.cutting import SEGMENT_S
from trimtab.host.trace.data.logs import Drive, read_logs
from trimtab.host.trace.prediction import rmse

DIVERGED_M = 100.0
"""Position error, m, above which a roll-out counts as diverged."""
MONTH_S = 365.25 / 12 * 86_400
DAY_S = 86_400
DRIFT_FLIGHTS_MIN = 3
"""Fewest dated flights for a drift. They must also span more than a day."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Prediction error of one model, of one flight or of several: root mean squares over all samples.

    The numbers, in m and m/s, are infinite if a roll-out diverged.
    """

    position_rmse_m: float
    velocity_rmse_m_s: float
    position_max_m: float

    @property
    def diverged(self) -> bool:
        """Whether a roll-out diverged."""
        return math.isinf(self.position_rmse_m)

    def to_dict(self) -> dict[str, float | None]:
        """Return the numbers as plain data for JSON; None for one that is infinite."""
        return {name: value if math.isfinite(value) else None for name, value in vars(self).items()}


@dataclass(frozen=True, kw_only=True)
class FlightPrediction:
    """Prediction errors on one flight.

    log, id, reference: file, its id, id of the reference. date: UTC, None if the log has none.
    used: whether the model was made from this flight, so that its error is no test.
    """

    log: str
    id: str
    reference: str | None
    date: datetime.datetime | None
    used: bool
    model: Score
    nominal: Score

    @property
    def difference_m(self) -> float:
        """Position RMSE with the model minus without it; 0 if both diverge, infinite if one does."""
        if self.model.diverged and self.nominal.diverged:
            return 0.0
        return self.model.position_rmse_m - self.nominal.position_rmse_m

    def to_dict(self) -> dict[str, Any]:
        """Return the flight as plain data for JSON."""
        difference_m = self.difference_m
        return {
            "log": self.log,
            "id": self.id,
            "reference": self.reference,
            "date": date_text(self.date),
            "used": self.used,
            "diverged": self.model.diverged,
            "nominal_diverged": self.nominal.diverged,
            "model": self.model.to_dict(),
            "nominal": self.nominal.to_dict(),
            "difference_m": difference_m if math.isfinite(difference_m) else None,
        }


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Slope of the position RMSE with the model over the dates of flights, m a month, with its interval."""

    slope_m_month: float
    low_m_month: float
    high_m_month: float
    flights: int
    days: float

    def to_dict(self) -> dict[str, float | int]:
        """Return the drift as plain data for JSON."""
        return dict(vars(self))


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Prediction errors of a model on flights of its vehicle.

    Attributes
    ----------
    model_id
        Id of the model; None for the nominal model.
    vehicle
        Name of the vehicle.
    drive, horizon_s
        Data that drive the predictions, and how far they reach; None for whole flights.
    flights
        The flights, those with a date first and in the order of their dates.
    together, nominal_together
        Errors over the samples of all flights, with the model and with the nominal one.
    inactive
        Effects of the model that do not act in predictions of these logs, because the logs lack what shows
        them.
    """

    model_id: str | None
    vehicle: str
    drive: Drive
    horizon_s: float | None
    flights: tuple[FlightPrediction, ...]
    together: Score
    nominal_together: Score
    inactive: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Prediction: {len(self.flights)} flights of {self.vehicle}>"

    def _repr_html_(self) -> str:
        from trimtab.host.compare.prediction_words import prediction_card

        return prediction_card(self)

    @property
    def median_m(self) -> float | None:
        """Median of the flights' position RMSE, a diverged one counting as infinite; None if it is that."""
        return median_of([flight.model.position_rmse_m for flight in self.flights])

    @property
    def nominal_median_m(self) -> float | None:
        """The same with the nominal model."""
        return median_of([flight.nominal.position_rmse_m for flight in self.flights])

    @property
    def difference(self) -> Difference | None:
        """Difference of the position RMSE over the flights, model minus nominal; None for the nominal one."""
        if self.model_id is None:
            return None
        return paired_difference([flight.difference_m for flight in self.flights])

    @property
    def better(self) -> int:
        """Number of flights that the model predicts better than the nominal one."""
        return sum(flight.difference_m < 0.0 for flight in self.flights)

    @property
    def diverged(self) -> tuple[str, ...]:
        """Logs on which the roll-out with the model diverged."""
        return tuple(flight.log for flight in self.flights if flight.model.diverged)

    @property
    def drift(self) -> Drift | None:
        """Trend of the error over dates; None with too few dated flights, too near, or if one diverged."""
        dated = [(flight.date, flight.model) for flight in self.flights if flight.date is not None]
        if len(dated) < DRIFT_FLIGHTS_MIN or any(score.diverged for _, score in dated):
            return None
        times_s = [date.timestamp() for date, _ in dated]
        span_s = max(times_s) - min(times_s)
        if span_s <= DAY_S:
            return None
        months = [(time_s - times_s[0]) / MONTH_S for time_s in times_s]
        line = trend(months, [score.position_rmse_m for _, score in dated])
        return Drift(
            slope_m_month=line.slope,
            low_m_month=line.low,
            high_m_month=line.high,
            flights=len(dated),
            days=span_s / DAY_S,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as plain data for JSON."""
        difference, drift = self.difference, self.drift
        return {
            "model_id": self.model_id,
            "vehicle": self.vehicle,
            "drive": self.drive,
            "horizon_s": self.horizon_s,
            "flights": [flight.to_dict() for flight in self.flights],
            "model": {**self.together.to_dict(), "median_m": self.median_m},
            "nominal": {**self.nominal_together.to_dict(), "median_m": self.nominal_median_m},
            "difference": None if difference is None else difference.to_dict(),
            "better": None if difference is None else self.better,
            "diverged": list(self.diverged),
            "drift": None if drift is None else drift.to_dict(),
            "inactive": list(self.inactive),
        }


@parallel.one_thread_of_algebra()
def predict(
    model: Model | None,
    flights: Sequence[Flight],
    effects: Mapping[str, Effect] | None = None,
    *,
    jobs: int | None = None,
) -> Prediction:
    """Predict flights with a model and with the nominal model of the same vehicle, and return the errors.

    A flight on which a roll-out diverges counts, with an infinite error.

    Parameters
    ----------
    model
        Model of the flights' vehicle; None for the nominal model alone.
    flights
        Flights of one vehicle, at least one.
    effects
        Effects by name; those that come with Trimtab if None.
    jobs
        Threads; as many as there are cores if None. The result does not depend on it.

    Raises
    ------
    UsageError
        If the model is of another vehicle, has an effect that is not known, or has a network and a log lacks
        the reference or the control law; if no flight is given. As LogsRefused if the logs cannot be used
        together, as `read_logs` does.
    TooLittleData
        If a flight is too short to predict.
    """
    if not flights:
        raise UsageError("no flight to predict; give one or more")
    effects = load_effects() if effects is None else effects
    jobs = parallel.cores() if jobs is None else jobs
    vehicle = flights[0].vehicle
    if model is not None:
        if model.vehicle_id != vehicle.id:
            raise UsageError(
                f"the model is of vehicle {model.vehicle_name} ({model.vehicle_id}), {flights[0].path} of "
                f"{vehicle.name} ({vehicle.id}); give flights of the model's vehicle"
            )
        try:
            model.parts(effects)
        except ValueError as error:
            raise UsageError(f"{error}; give the folder with its effects with --workspace") from None
    logs = read_logs(flights, (), None)
    with_model, nominal, inactive = measured_errors(logs, model, effects, jobs)
    used = () if model is None else model.data
    rows = [
        FlightPrediction(
            log=str(flight.path),
            id=flight.id,
            reference=flight.reference_id,
            date=utc_date(flight.metadata),
            used=flight.id in used,
            model=_score([errors]),
            nominal=_score([baseline]),
        )
        for flight, errors, baseline in zip(flights, with_model, nominal, strict=True)
    ]
    rows.sort(key=lambda row: math.inf if row.date is None else row.date.timestamp())
    return Prediction(
        model_id=None if model is None else model.id,
        vehicle=vehicle.name,
        drive=logs.drive,
        horizon_s=None if logs.drive == "reference" else SEGMENT_S,
        flights=tuple(rows),
        together=_score(with_model),
        nominal_together=_score(nominal),
        inactive=inactive,
    )


def _score(errors: MaybeErrors) -> Score:
    """Return the score of one or more flights. Errors are None where the roll-out is known to diverge."""
    known = [each for each in errors if each is not None]
    with np.errstate(over="ignore", invalid="ignore"):
        distances = [np.linalg.norm(each.p_error_ned, axis=1) for each in known]
        # A comparison with something that is not a number is false.
        if len(known) < len(errors) or not all((each <= DIVERGED_M).all() for each in distances):
            return Score(position_rmse_m=math.inf, velocity_rmse_m_s=math.inf, position_max_m=math.inf)
    return Score(**rmse(known), position_max_m=float(max(each.max() for each in distances)))
