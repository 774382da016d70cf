"""The residual of the nominal model along a flight, from means that the vehicle sends."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

from trimtab.host.vehicle import Vehicle


class NominalResidual:
    """Specific force that the nominal model does not predict: measured minus that of four lagged rotors.

    Intervals come in the order of time. A rotor's thrust approaches that of its command with `motor_lag_s`,
    from the first command on.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._linear_n, self._quadratic_n = (vehicle.thrust_max_n * c for c in vehicle.thrust_curve)
        self._lag_s = vehicle.motor_lag_s
        self._mass_kg = vehicle.mass_kg
        self._thrust_n: float | None = None

    def push(
        self, interval_us: int, motor_mean: Sequence[float], force_mean: Sequence[float]
    ) -> tuple[float, float, float]:
        """Return the mean residual over the next interval, FRD, m/s^2.

        interval_us: positive. motor_mean: (4,), 0 to 1. force_mean: specific force (3,), FRD, m/s^2.
        """
        a, b, c, d = motor_mean
        commanded_n = self._linear_n * (a + b + c + d) + self._quadratic_n * (a * a + b * b + c * c + d * d)
        before_n = commanded_n if self._thrust_n is None else self._thrust_n
        lags = interval_us * 1e-6 / self._lag_s
        decay = exp(-lags)
        self._thrust_n = commanded_n + (before_n - commanded_n) * decay
        mean_n = commanded_n + (before_n - commanded_n) * (1.0 - decay) / lags
        return force_mean[0], force_mean[1], force_mean[2] + mean_n / self._mass_kg
