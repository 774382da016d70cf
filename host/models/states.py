"""A flight as phi sees it: smoothed states, rotor thrusts and controller memory over its tracking phase."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from trimtab.firmware_model.law import step as law_step
from trimtab.firmware_model.law.allocation import command_to_thrust
from trimtab.host.log import Control, Flight, Observer
from trimtab.host.log.prepare import STEP_S, Prepared, prepare
from trimtab.host.models.bias import accelerometer_bias, standing_errors
from trimtab.host.models.drive import FlightConstants, flight_constants
from trimtab.host.models.phi import INTEGRAL, Phi
from trimtab.host.models.reference import block, thrust_gain
from trimtab.host.vehicle import Vehicle, to_parameters
from trimtab.protocol.blobs import FeedForward, Reference
from trimtab.protocol.parameters import DEFAULTS

PLAUSIBLE_VOLTAGE = (0.5, 1.3)
"""Bounds of a plausible battery voltage, as a share of the full voltage."""
_RATE_SIGMA = 0.01
"""rad/s: a gyro noise of 0.02 averaged over 10 ms or more, and the error of averaging over a step."""
_LEAST_SIGMA = (2e-4, 3e-3, 1e-3)
"""m, m/s, rad: lower bounds, because a smoother is no better than its model of the motion."""


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """A flight's tracking phase at t_s, seconds since the reference's start, every `step_s`.

    x: p, v (NED), Theta, body rate (FRD); sigma: of each. thrust: lagged nominal rotor thrusts, N. integral:
    the law's rate integral. constants: `flight_constants`. observer: the disturbance observed on board,
    m/s^2, NED; None where none was logged. seen: whether there are poses near the sample; None where there
    are everywhere. notes: what was left out of the log.
    """

    flight_id: str
    reference_id: str
    vehicle: Vehicle
    reference: Reference
    feedforward: FeedForward | None
    parameters: Mapping[str, float] | None
    step_s: float
    t_s: Annotated[np.ndarray, "samples"]
    x: Annotated[np.ndarray, "samples 12"]
    sigma: Annotated[np.ndarray, "12"]
    thrust: Annotated[np.ndarray, "samples 4"]
    integral: Annotated[np.ndarray, "samples 3"]
    voltage_ratio: Annotated[np.ndarray, "samples"]
    constants: Annotated[np.ndarray, "15"]
    observer: Annotated[np.ndarray, "samples 3"] | None = None
    seen: Annotated[np.ndarray, "samples"] | None = None
    notes: tuple[str, ...] = ()

    def initial(self, phi: Phi, k: int = 0) -> Annotated[np.ndarray, "size"]:
        """Return phi's state at sample k.

        The estimator's errors are the constant ones that the accelerometer's bias causes.
        """
        constants = FlightConstants(*self.constants)
        x = np.zeros(phi.size)
        x[0:12], x[12:16] = self.x[k], self.thrust[k]
        if phi.drive != "inputs":
            x[INTEGRAL] = self.integral[k]
            if phi.errors.stop <= phi.size:
                R = Rotation.from_euler("ZYX", self.x[k, 8:5:-1]).as_matrix()
                gains = law_step.estimator_gains(phi.firmware)
                excess = R @ constants.accelerometer_bias
                errors = standing_errors(gains, constants.mocap_age_s, constants.mocap_interval_s)
                for i, per_bias in enumerate(errors):
                    x[phi.errors.start + 3 * i : phi.errors.start + 3 * i + 3] = per_bias * excess
            if phi.observes:
                gain = float(thrust_gain(self.feedforward, self.voltage_ratio[k]))
                d_hat = np.zeros(3) if self.observer is None else self.observer[k]
                x[phi.observer] = [*d_hat, gain * self.thrust[k].sum()]
            if phi.commands.stop > phi.commands.start:
                x[phi.commands] = self.thrust[k]
        x[phi.memory] = phi.at_rest(x)
        return x


def flight_states(
    flights: Sequence[Flight], *, step_s: float = STEP_S, latency_s: float = 0.0
) -> list[States]:
    """Return the states of the flights' tracking phases, with poses `latency_s` older than stamped.

    All flights at once take less time than one by one. Raises TooLittleData as `trimtab.host.log.prepare`
    does.
    """
    return [states_of(prepared) for prepared in prepare(flights, step_s=step_s, latency_s=latency_s)]


def states_of(prepared: Prepared) -> States:
    """Return the states of a flight that was smoothed."""
    flight, times_s = prepared.flight, prepared.at_s
    control, reference = flight.control, flight.reference
    assert control is not None
    assert reference is not None
    # A tick integrates its errors over the following tick: on average the logged value is half a tick ahead.
    integral_s = control.sensed_us[:, 1] * 1e-6
    return States(
        flight_id=flight.id,
        reference_id=flight.reference_id or reference.id,
        vehicle=flight.vehicle,
        reference=reference,
        feedforward=flight.feedforward,
        parameters=flight.firmware_parameters,
        step_s=prepared.step_s,
        t_s=times_s - prepared.start_s,
        x=prepared.x,
        sigma=_sigma(prepared),
        thrust=_thrusts(flight.vehicle, control, times_s),
        integral=_interpolated(times_s, integral_s, control.rate_integral),
        voltage_ratio=np.interp(times_s, *battery_of(flight)),
        constants=_constants(prepared),
        observer=_observed(flight.observer, times_s),
        seen=prepared.seen,
        notes=prepared.notes,
    )


def _sigma(prepared: Prepared) -> np.ndarray:
    """Return the standard deviation (12,) of the smoothed states."""
    least_p, least_v, least_theta = _LEAST_SIGMA
    spread = np.sqrt(np.maximum(np.einsum("nii->ni", prepared.path_covariance), 0.0))
    return np.repeat(
        [
            max(float(np.median(spread[:, 0])), least_p),
            max(float(np.median(spread[:, 1])), least_v),
            max(float(np.median(prepared.theta_sigma)), least_theta),
            _RATE_SIGMA,
        ],
        3,
    )


def _constants(prepared: Prepared) -> np.ndarray:
    """Return the constants (16,) of the flight, with the accelerometer's bias estimated."""
    flight, times_s, x = prepared.flight, prepared.at_s, prepared.x
    estimate, tracking = flight.estimate, flight.tracking
    assert estimate is not None
    assert tracking is not None
    tracked = (estimate.t_us >= tracking[0]) & (estimate.t_us <= tracking[1])
    # Telemetry's age of a pose grows until the next one: at the pose's use it is half an interval less.
    age_s = (
        float(np.mean(estimate.mocap_age_s[tracked])) - 0.5 * prepared.interval_s if tracked.any() else 0.0
    )
    age_s = max(age_s, 0.0)
    imu_bias, per_gravity = accelerometer_bias(
        _interpolated(times_s, estimate.t_us * 1e-6, estimate.p) - x[:, 0:3],
        Rotation.from_euler("ZYX", x[:, 8:5:-1]).as_matrix(),
        x[:, 3:6],
        np.gradient(x[:, 3:6], prepared.step_s, axis=0),
        x[:, 9:12],
        gains=law_step.estimator_gains(law_step.parameter_vector(firmware_parameters_of(flight))),
        age_s=age_s,
        interval_s=prepared.interval_s,
        step_s=prepared.step_s,
    )
    return flight_constants(
        block(flight.feedforward),
        mocap_age_s=age_s,
        mocap_interval_s=prepared.interval_s,
        accelerometer_bias=imu_bias,
        bias_per_gravity=per_gravity,
    )


def _interpolated(times_s: np.ndarray, at_s: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the columns (n, k), known at at_s, at times_s: linear interpolation."""
    return np.column_stack([np.interp(times_s, at_s, column) for column in columns.T])


def _observed(observer: Observer | None, times_s: np.ndarray) -> np.ndarray | None:
    """Return the observed disturbance (n, 3) at times (n,), None where none was logged."""
    return None if observer is None else _interpolated(times_s, observer.t_us * 1e-6, observer.disturbance)


def firmware_parameters_of(flight: Flight) -> Mapping[str, float]:
    """Return the firmware's parameters of a flight, by name: the vehicle file's if the log holds none."""
    table = flight.firmware_parameters
    return to_parameters(flight.vehicle) if table is None else {**DEFAULTS, **table}


def _thrusts(vehicle: Vehicle, control: Control, times_s: np.ndarray) -> np.ndarray:
    """Return the nominal rotor thrusts (n, 4), N: the commands with the vehicle file's lag."""
    commanded = command_to_thrust(control.motor_mean, vehicle.thrust_max_n, *vehicle.thrust_curve)
    edges = np.concatenate([control.t0_us[:1], control.t1_us]) * 1e-6
    stay = np.exp(-np.diff(edges) / vehicle.motor_lag_s)
    thrust = [commanded[0].tolist()]
    for target, share in zip(commanded.tolist(), stay.tolist(), strict=True):
        thrust.append([to + share * (now - to) for to, now in zip(target, thrust[-1], strict=True)])
    return _interpolated(times_s, edges, np.array(thrust))


def battery_of(flight: Flight) -> tuple[Annotated[np.ndarray, "samples"], Annotated[np.ndarray, "samples"]]:
    """Return times, s, and battery voltage over full voltage, implausible values left out.

    Where nothing plausible was logged, return a single 1 at 0 s.
    """
    if flight.battery is not None:
        ratio = flight.battery.battery_v / flight.vehicle.battery.full_v
        measured = (ratio > PLAUSIBLE_VOLTAGE[0]) & (ratio < PLAUSIBLE_VOLTAGE[1])
        if measured.any():
            return flight.battery.t_us[measured] * 1e-6, ratio[measured]
    return np.zeros(1), np.ones(1)
