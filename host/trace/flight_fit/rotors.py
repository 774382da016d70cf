"""Measured rotor speeds as data about the rotors alone: lag, delay, dead zone and sag.

The logged commands drive the rotors of the model. The square of a measured speed, over that at the greatest
thrust, is the thrust that the nominal propeller would make at that speed. What a propeller or the air adds is
not in it. So these data part what slows a rotor from what takes its thrust.

Their Gram is added to that of the flights. It is linearised once, and again only if the parameters have moved
far. An autoregression over neighbouring bins whitens the residual of the best fit, so the error of the
equations of lag and sag counts as noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from trimtab.host.codegen.ops import NUMPY
from trimtab.host.models import slots
from trimtab.host.models.airframe import Part
from trimtab.host.trace import evidence
from trimtab.host.trace.data.signals import FlightData, averaged, nominal_thrust
from trimtab.host.trace.decision.rules import RULES
from trimtab.host.trace.flight_fit.recording import FLIGHT_BIN_S, LEAD_S, bins_of_times
from trimtab.host.trace.parameters import ParameterSpace
from trimtab.host.vehicle import Vehicle

STEP_S = 0.01
"""Step of the rotors' roll-out."""

_PER_BIN = round(FLIGHT_BIN_S / STEP_S)
_LAGS = 2
"""Earlier bins of the autoregression."""
_THETA_STEP = 1e-3
"""Step of the difference quotients, scaled."""
_FAR = 0.1
"""Change of a parameter, scaled, after which the speeds are linearised again."""
_FITS = 3
"""Gauss-Newton steps to the residual that the autoregression is fitted to."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Speeds:
    """Rotor speeds of one flight, as shares of the greatest thrust.

    command_n: commanded thrust of each rotor, means over steps. voltage_ratio: at the end of each step.
    measured: means over bins. known: bins with a measurement of every rotor.
    """

    command_n: Annotated[np.ndarray, "steps 4"]
    voltage_ratio: Annotated[np.ndarray, "steps"]
    measured: Annotated[np.ndarray, "bins 4"]
    known: Annotated[np.ndarray, "bins"]


class RotorSpeeds:
    """Measured rotor speeds of flights. Flights without them have a Gram of zeros."""

    def __init__(self, flights: Sequence[FlightData], vehicle: Vehicle, space: ParameterSpace) -> None:
        self._vehicle, self._space = vehicle, space
        self._flights = [_speeds(data) for data in flights]
        acting = [name for name in space.parts if space.effects[name].acts_on_rotor_speed]
        self._columns = np.array([i for name in acting for i in space.owners[name]], dtype=int)
        self._whitening: tuple[np.ndarray, float] | None = None
        self._at: np.ndarray | None = None
        self._grams = np.zeros(0)

    @property
    def present(self) -> bool:
        """Whether any flight has rotor speeds, and any effect acts on them."""
        return bool(len(self._columns)) and any(flight is not None for flight in self._flights)

    def grams(
        self, theta_scaled: Annotated[np.ndarray, "parameters"]
    ) -> Annotated[np.ndarray, "flights columns columns"]:
        """Return the Grams of the whitened [residual | slopes] of each flight, over RULES.temper[-1]."""
        if self._at is None or np.abs(theta_scaled - self._at)[self._columns].max() > _FAR:
            self._linearise(theta_scaled)
        assert self._at is not None
        shift = np.eye(1 + len(theta_scaled))
        shift[1:, 0] = self._at - theta_scaled
        return shift.T @ self._grams @ shift

    def squares(
        self, theta_scaled: Annotated[np.ndarray, "parameters lanes"]
    ) -> Annotated[np.ndarray, "lanes"]:
        """Return the whitened squares of all flights at each lane, of full roll-outs, over the same."""
        coefficients, sigma = self._whitening_from(theta_scaled[:, 0])
        total = np.zeros(theta_scaled.shape[1])
        for flight in self._flights:
            if flight is None:
                continue
            for lane, (rolled, rate) in enumerate(zip(*self._rolled(flight, theta_scaled), strict=True)):
                columns = np.where(flight.known[:, None], flight.measured - rolled, 0.0)[None]
                left = _without_nuisances(columns, *self._where_known(flight, rolled, rate))
                total[lane] += np.square(_whitened(left, coefficients, sigma)).sum()
        return total / RULES.temper[-1]

    def _linearise(self, theta_scaled: np.ndarray) -> None:
        """Compute the Grams anew."""
        coefficients, sigma = self._whitening_from(theta_scaled)
        count = 1 + len(theta_scaled)
        self._grams = np.zeros((len(self._flights), count, count))
        rows = np.concatenate([[0], 1 + self._columns])
        for index, columns in self._residuals_and_slopes(theta_scaled):
            white = _whitened(columns, coefficients, sigma)
            self._grams[index][np.ix_(rows, rows)] = white @ white.T / RULES.temper[-1]
        self._at = theta_scaled.copy()

    def _whitening_from(self, theta_scaled: np.ndarray) -> tuple[np.ndarray, float]:
        """Return autoregression and innovation, fitted once, from the first point that asks for them."""
        if self._whitening is None:
            self._whitening = self._fitted_whitening(theta_scaled)
        return self._whitening

    def _fitted_whitening(self, theta_scaled: np.ndarray) -> tuple[np.ndarray, float]:
        """Return autoregression and innovation of the residual of the best fit of all effects on rotors."""
        at = theta_scaled.copy()
        coefficients, sigma = np.zeros(_LAGS), RULES.rotor_speed_sigma
        precision = np.full(len(self._columns), 1.0 / RULES.slab_sigma**2)
        lower, upper = (bound[self._columns] for bound in self._space.bounds)
        for turn in range(_FITS + 1):
            flights = [columns for _, columns in self._residuals_and_slopes(at)]
            if turn:
                coefficients, sigma = _autoregression([columns[0] for columns in flights])
            if turn == _FITS:
                break
            white = np.concatenate([_whitened(each, coefficients, sigma) for each in flights], axis=1)
            step, _ = evidence.bounded_step(white @ white.T, at[self._columns], precision, (lower, upper))
            at[self._columns] += step
        return coefficients, sigma

    def _residuals_and_slopes(self, at: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Return [residual | slopes] (columns, bins, 4) of each flight with speeds, without nuisances."""
        lanes = np.repeat(at[:, None], 1 + len(self._columns), axis=1)
        lanes[self._columns, 1 + np.arange(len(self._columns))] += _THETA_STEP
        result = []
        for index, flight in enumerate(self._flights):
            if flight is None:
                continue
            rolled, rate = self._rolled(flight, lanes)
            columns = np.concatenate(
                [(flight.measured - rolled[0])[None], (rolled[1:] - rolled[0]) / _THETA_STEP]
            )
            columns[:, ~flight.known] = 0.0
            result.append(
                (index, _without_nuisances(columns, *self._where_known(flight, rolled[0], rate[0])))
            )
        return result

    @staticmethod
    def _where_known(flight: _Speeds, *predicted: np.ndarray) -> list[np.ndarray]:
        """Return predictions (bins, 4) with 0 where nothing was measured."""
        return [np.where(flight.known[:, None], each, 0.0) for each in predicted]

    def _rolled(
        self, flight: _Speeds, lanes: np.ndarray
    ) -> tuple[Annotated[np.ndarray, "lanes bins 4"], Annotated[np.ndarray, "lanes bins 4"]]:
        """Return the shares of the greatest thrust that the model's rotors reach, and their rates, 1/s.

        Both are means over bins.
        """
        vehicle, values = self._vehicle, self._space.values(lanes)
        by_owner = self._space.by_owner(list(values))
        parts: list[Part] = [
            (self._space.effects[name], by_owner[name])
            for name in self._space.parts
            if self._space.effects[name].acts_on_rotor_speed
        ]
        count = lanes.shape[1]
        delay = np.broadcast_to(np.asarray(slots.command_delay_s(NUMPY, parts)), (count,)) / STEP_S
        lag = slots.motor_lag_s(NUMPY, vehicle, parts)
        at = np.arange(len(flight.command_n))[:, None] - delay
        steps = np.arange(len(flight.command_n))
        command = np.stack([np.interp(at, steps, column) for column in flight.command_n.T], axis=1)
        driven = [
            np.broadcast_to(each, (len(steps), count))
            for each in slots.driven_thrusts_n(NUMPY, vehicle, parts, list(command.transpose(1, 0, 2)))
        ]
        target = np.stack(driven, axis=1)
        thrust = target[0].copy()
        out = np.empty_like(target)
        for k, wanted in enumerate(target):
            before = thrust
            lags = np.stack(
                [
                    np.broadcast_to(each, (count,))
                    for each in slots.rotor_lags_s(NUMPY, parts, lag, list(wanted), list(thrust))
                ]
            )
            thrust = wanted + (thrust - wanted) * np.exp(-STEP_S / lags)
            out[k] = 0.5 * (before + thrust)
        slowed = slots.speed_thrusts_n(
            NUMPY, vehicle, parts, list(out.transpose(1, 0, 2)), flight.voltage_ratio[:, None]
        )
        shares = np.stack([np.broadcast_to(each, out[:, 0].shape) for each in slowed], axis=2)
        shares = shares[: len(flight.measured) * _PER_BIN] / vehicle.thrust_max_n
        rates = np.gradient(shares, STEP_S, axis=0)
        means = (x.reshape(-1, _PER_BIN, count, 4).mean(1).transpose(1, 0, 2) for x in (shares, rates))
        return next(means), next(means)


def _speeds(data: FlightData) -> _Speeds | None:
    """Return the rotor speeds of a flight; None if it has none."""
    rotors, s = data.flight.rotors, data.signals
    if rotors is None:
        return None
    start, end = s.span_s
    bins = int((end - start) / FLIGHT_BIN_S)
    steps = start + STEP_S * np.arange(bins * _PER_BIN + 1)
    command, _ = averaged(steps, s.input_s, nominal_thrust(data.flight.vehicle, s.command, in_newton=False))
    t_s = rotors.t_us * 1e-6
    inside = (t_s >= start) & (t_s < start + bins * FLIGHT_BIN_S) & np.isfinite(rotors.speed).all(1)
    index = bins_of_times(t_s[inside] - start, bins)
    count = np.bincount(index, minlength=bins)
    sums = [np.bincount(index, column, minlength=bins) for column in rotors.speed[inside].T ** 2]
    return _Speeds(
        command_n=command,
        voltage_ratio=np.interp(steps[1:], s.voltage_s, s.voltage_ratio),
        measured=np.column_stack(sums) / np.maximum(count, 1)[:, None],
        known=(count > 0) & (np.arange(bins) * FLIGHT_BIN_S > LEAD_S),
    )


def _without_nuisances(
    columns: Annotated[np.ndarray, "columns bins 4"],
    rolled: Annotated[np.ndarray, "bins 4"],
    rate: Annotated[np.ndarray, "bins 4"],
) -> Annotated[np.ndarray, "columns bins 4"]:
    """Return the columns without what the nuisances of the measurement explain, within their tolerances.

    They are a factor on each rotor, and an age of all speeds at their stamps. rolled, rate: predicted
    shares and their rates.
    """
    nuisances = np.stack(
        [
            *(RULES.rotor_scale_sigma * rolled * rotor for rotor in np.eye(4)),
            RULES.rotor_age_sigma_s * rate,
        ]
    )
    N = nuisances.reshape(len(nuisances), -1) / RULES.rotor_speed_sigma
    flat = columns.reshape(len(columns), -1)
    part = np.linalg.solve(N @ N.T + np.eye(len(N)), N @ flat.T)
    return (flat - part.T @ N).reshape(columns.shape)


def _autoregression(residuals: Sequence[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return the coefficients of the earlier bins and the innovation sd, common to rotors and flights."""
    past = np.concatenate(
        [
            np.stack([r[_LAGS - k : len(r) - k].ravel() for k in range(1, _LAGS + 1)], axis=1)
            for r in residuals
        ]
    )
    now = np.concatenate([r[_LAGS:].ravel() for r in residuals])
    coefficients, *_ = np.linalg.lstsq(past, now, rcond=None)
    sigma = float(np.sqrt(np.square(now - past @ coefficients).mean()))
    return coefficients, max(sigma, RULES.rotor_speed_sigma)


def _whitened(columns: np.ndarray, coefficients: np.ndarray, sigma: float) -> np.ndarray:
    """Return columns (columns, bins, 4) as innovations of unit variance, (columns, innovations)."""
    out = columns[:, _LAGS:].copy()
    for k, coefficient in enumerate(coefficients, start=1):
        out -= coefficient * columns[:, _LAGS - k : columns.shape[1] - k]
    return out.reshape(len(columns), -1) / sigma
