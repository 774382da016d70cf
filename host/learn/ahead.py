"""Prediction errors over short times from recorded motor commands.

A flight by a controller on the host cannot be predicted from its reference: the model knows the law on board,
not the controller. Its recorded motor commands predict it for a short time from a measured state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from trimtab.firmware_model.law.allocation import command_to_thrust
from trimtab.host.learn.evaluate import Errors, errors_of
from trimtab.host.log import Flight
from trimtab.host.log.errors import TooLittleData
from trimtab.host.models.drive import COMMANDED_THRUST, DRIVE_ROWS, INPUTS_VOLTAGE_AND_TIME
from trimtab.host.models.network import Network
from trimtab.host.models.phi import Phi
from trimtab.host.models.rollout import half_steps, roll_out
from trimtab.host.models.states import States

AHEAD_S = 0.6
"""Time of each prediction."""


def ahead(
    phi: Phi,
    theta: Annotated[np.ndarray, "parameters"],
    flights: Sequence[States],
    logs: Sequence[Flight],
    network: Network | None = None,
) -> Errors:
    """Return the errors over AHEAD_S from the recorded motor commands, end to end over each tracking phase.

    logs: of the same flights. phi: its drive does not matter. Every prediction starts at the measured state.
    Predictions without poses near all their samples do not count. Raises TooLittleData where none remains.
    """
    by_inputs = replace(phi, drive="inputs", estimator=False)
    squares: list[np.ndarray] = []
    for states, log in zip(flights, logs, strict=True):
        steps = round(AHEAD_S / states.step_s)
        starts = [
            k
            for k in range(0, len(states.t_s) - steps, steps)
            if states.seen is None or states.seen[k : k + steps + 1].all()
        ]
        if starts:
            squares.append(_squares(by_inputs, theta, states, log, network, np.array(starts), steps))
    if not squares:
        raise TooLittleData(
            f"no {AHEAD_S:g} s with poses in the flights that are held out; hold out longer ones"
        )
    return errors_of(np.concatenate(squares))


def _squares(
    phi: Phi,
    theta: np.ndarray,
    states: States,
    log: Flight,
    network: Network | None,
    starts: np.ndarray,
    steps: int,
) -> np.ndarray:
    """Return the squared errors (n, 6) of position and velocity after the start of each prediction."""
    split = phi.substeps(states.step_s)
    step_s = states.step_s / split
    stages = half_steps(0.0, split * steps, step_s)
    times = states.t_s[starts] + stages[:, None]
    predicted = roll_out(
        phi,
        x0=np.stack([states.initial(phi, int(k)) for k in starts], axis=1),
        drive=_drive(states, log, times),
        flight=states.constants,
        theta=theta,
        step_s=step_s,
        every=split,
        network=network,
        compiled=True,
    )
    measured = np.stack([states.x[k : k + steps + 1, :6] for k in starts], axis=2)
    return ((predicted[:, :6] - measured)[1:] ** 2).transpose(0, 2, 1).reshape(-1, 6)


def _drive(states: States, log: Flight, times: np.ndarray) -> np.ndarray:
    """Return the drive `inputs` (stages, rows, predictions) at reference times (stages, predictions)."""
    control, tracking, vehicle = log.control, log.tracking, states.vehicle
    assert control is not None
    assert tracking is not None
    commanded = command_to_thrust(control.motor_mean, vehicle.thrust_max_n, *vehicle.thrust_curve)
    begin_s = 1e-6 * (control.t0_us - tracking[0])
    at = np.clip(np.searchsorted(begin_s, times, side="right") - 1, 0, len(begin_s) - 1)
    drive = np.empty((len(times), DRIVE_ROWS["inputs"], times.shape[1]))
    drive[:, COMMANDED_THRUST] = commanded[at].transpose(0, 2, 1)
    drive[:, INPUTS_VOLTAGE_AND_TIME] = np.stack(
        [np.interp(times, states.t_s, states.voltage_ratio), times], axis=1
    )
    return drive
