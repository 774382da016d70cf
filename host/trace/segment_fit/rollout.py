"""Roll-outs of segments with many initial states, parameters and disturbances at once, as lanes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np

from trimtab.host.base import parallel
from trimtab.host.trace.data.segments import BIN_S, PATH_S, Segments
from trimtab.host.trace.segment_fit.model import CHANNELS, STATES, SegmentModel

_TOGETHER = 16
"""Flights along which the states of effects are integrated together."""


def roll_out(
    segment_model: SegmentModel,
    data: Segments,
    x0: Annotated[np.ndarray, "12 lanes segments"],
    theta_scaled: Annotated[np.ndarray, "parameters lanes"],
    nuisances: Annotated[np.ndarray, "nuisances lanes segments"],
    bins: Annotated[np.ndarray, "bins 6 lanes"] | None = None,
    memory: Annotated[np.ndarray, "memory lanes segments"] | None = None,
) -> Annotated[np.ndarray, "steps 12 lanes segments"]:
    """Return the predicted measurements of the lanes of each segment.

    The 12 predictions of a step are those of `trimtab.host.trace.segment_fit.model.CHANNELS`. Rotors start at
    the lagged command of the run-up.

    Parameters
    ----------
    segment_model
        Model of the segments.
    data
        Segments.
    x0
        Initial states: p, v NED, Euler angles Theta, body rate FRD.
    theta_scaled
        Scaled parameters of each lane.
    nuisances
        Nuisances of the flights.
    bins
        Disturbance in addition to that of the segments: specific force m/s^2, then angular acceleration
        rad/s^2, FRD.
    memory
        Initial states of the effects; `remembered` along the measured flight if None.
    """
    if segment_model.memory and memory is None:
        memory = remembered(segment_model, data, theta_scaled)
    if memory is None:
        memory = np.empty((0, *x0.shape[1:]))
    kernel = segment_model.kernel
    if kernel is None:
        return _roll_out_steps(segment_model, data, x0, theta_scaled, nuisances, bins, memory)
    predicted = kernel.roll_out(
        command=data.command,
        delay=segment_model.delay_s(theta_scaled) / segment_model.dt_s,
        series=_series(data),
        per_bin=round(BIN_S / data.dt_s),
        x0=x0,
        theta_scaled=theta_scaled,
        memory=memory,
        nuisances=nuisances,
        bins=bins,
    )
    return predicted.transpose(1, 2, 3, 0)


def _series(data: Segments) -> Annotated[np.ndarray, "segments steps 21"]:
    """Return what drives a step in addition to the commands, in the order of the inputs of "step"."""
    t_s = data.start_s[:, None] + np.arange(data.steps) * data.dt_s
    columns = [column[:, :, None] for column in (data.voltage_ratio, t_s, data.shift_s)]
    w = np.repeat(data.disturbance_frd, round(BIN_S / data.dt_s), axis=1)
    return np.concatenate([data.R_ned_frd, data.rate_frd, *columns, w], axis=2)


def _roll_out_steps(
    segment_model: SegmentModel,
    data: Segments,
    x0: np.ndarray,
    theta_scaled: np.ndarray,
    nuisances: np.ndarray,
    bins: np.ndarray | None,
    memory: np.ndarray,
) -> Annotated[np.ndarray, "steps 12 lanes segments"]:
    """Return what `roll_out` returns, by CasADi step by step."""
    lanes, count = x0.shape[1:]
    total = lanes * count
    step, pre = segment_model.bind("step", total), data.command.shape[1] - data.steps
    inputs, outputs = step.inputs, step.outputs
    repeated = np.repeat(theta_scaled, count, axis=1)
    inputs["z"][:] = repeated
    inputs["body"][:] = x0.reshape(STATES, total)
    inputs["nuisances"][:] = nuisances.reshape(segment_model.nuisances, total)
    inputs["memory"][:] = memory.reshape(segment_model.memory, total)
    commands = _delayed(segment_model, data.command, theta_scaled)
    inputs["thrust"][:] = _spun_up(segment_model, commands[:pre], repeated)
    series = _series(data).transpose(1, 2, 0)[:, :, None]
    if bins is not None:
        series = np.repeat(series, lanes, axis=2)
        series[:, -6:] += np.repeat(bins, round(BIN_S / data.dt_s), axis=0)[..., None]
    names = ("attitude", "rate", "voltage", "t_s", "shift_s", "w")
    ends = np.cumsum([inputs[name].shape[0] for name in names])
    predicted = np.empty((data.steps, CHANNELS, lanes, count))
    for k in range(data.steps):
        inputs["command"][:] = commands[pre + k]
        for name, rows in zip(names, np.split(series[k], ends[:-1]), strict=True):
            inputs[name].reshape(-1, lanes, count)[:] = rows
        step()
        predicted[k] = outputs["predicted_out"].reshape(CHANNELS, lanes, count)
        inputs["body"][:] = outputs["body_out"]
        inputs["thrust"][:] = outputs["thrust_out"]
        inputs["memory"][:] = outputs["memory_out"]
    return predicted


def _delayed(segment_model: SegmentModel, command: np.ndarray, theta_scaled: np.ndarray) -> np.ndarray:
    """Return the sent commands (segments, pre + steps, 4), delayed as at theta_scaled (parameters, lanes).

    The result is (pre + steps, 4, lanes * segments). Commands are means over steps, so a delay by a
    fraction of a step mixes two of them. Before the first command, the first command holds.
    """
    delayed = []
    for delay in segment_model.delay_s(theta_scaled):
        whole, share = divmod(float(delay) / segment_model.dt_s, 1.0)
        index = np.clip(np.arange(command.shape[1]) - int(whole), 0, command.shape[1] - 1)
        now, before = command[:, index], command[:, np.maximum(index - 1, 0)]
        delayed.append((1.0 - share) * now + share * before if share else now)
    lanes = np.transpose(np.array(delayed), (2, 3, 0, 1))
    return lanes.reshape(*lanes.shape[:2], -1)


def _spun_up(segment_model: SegmentModel, commands: np.ndarray, theta_scaled: np.ndarray) -> np.ndarray:
    """Return the rotor thrusts (4, lanes) in N after commands (n, 4, lanes).

    They start at the thrusts at which the first command would hold them.
    """
    rotors = segment_model.bind("rotors", commands.shape[2])
    rotors.inputs["z"][:] = theta_scaled
    for k, command in enumerate(commands):
        rotors.inputs["command"][:] = command
        if k == 0:
            rotors()
            rotors.inputs["thrust"][:] = rotors.outputs["settled"]
        rotors()
        rotors.inputs["thrust"][:] = rotors.outputs["next"]
    return rotors.outputs["next"].copy()


def remembered_by_flight(
    segment_model: SegmentModel,
    data: Segments,
    points: Callable[[int], Annotated[np.ndarray, "parameters lanes"]],
) -> Annotated[np.ndarray, "memory lanes segments"]:
    """Return the states of `remembered`; points: gives the scaled parameters of a flight."""
    if segment_model.space.rolled is segment_model.space:  # all flights have the same
        return remembered(segment_model, data, points(0))
    out = np.empty((segment_model.memory, points(0).shape[1], len(data.flight)))
    for flight in np.unique(data.flight).tolist():
        segments = np.flatnonzero(data.flight == flight)
        out[:, :, segments] = remembered(segment_model, data.of_flight(flight, segments), points(flight))
    return out


def remembered(
    segment_model: SegmentModel, data: Segments, theta_scaled: Annotated[np.ndarray, "parameters lanes"]
) -> Annotated[np.ndarray, "memory lanes segments"]:
    """Return the states of the effects at the start of each segment for theta_scaled.

    They are integrated along the measured paths of the flights.
    """
    if not segment_model.memory:
        return np.empty((0, theta_scaled.shape[1], len(data.flight)))
    columns = [
        i for name, rows in segment_model.rolled.owners.items() if segment_model.memory_of(name) for i in rows
    ]
    distinct, lane = np.unique(theta_scaled[columns], axis=1, return_inverse=True)
    values = np.repeat(theta_scaled[:, :1], distinct.shape[1], axis=1)
    values[columns] = distinct
    out = np.empty((segment_model.memory, theta_scaled.shape[1], len(data.flight)))

    def integrate(flights: np.ndarray) -> None:
        segments = np.flatnonzero(np.isin(data.flight, flights))
        states = along(values, data.paths[flights])
        position = data.path_start_s[segments] / PATH_S
        low = np.clip(position.astype(int), 0, states.shape[1] - 2)
        share = np.clip(position - low, 0.0, 1.0)[:, None]
        flight = np.searchsorted(flights, data.flight[segments])
        before, after = (states[flight, low + end] for end in (0, 1))
        starts = (1.0 - share[..., None]) * before + share[..., None] * after
        out[:, :, segments] = np.moveaxis(starts[:, :, lane], 0, 2)

    kernel = segment_model.kernel
    along = (
        partial(_along_paths, segment_model) if kernel is None else partial(kernel.along_paths, dt_s=PATH_S)
    )
    together = np.split(np.arange(len(data.paths)), np.arange(_TOGETHER, len(data.paths), _TOGETHER))
    parallel.each(integrate, together, segment_model.jobs)
    return out


def _along_paths(
    segment_model: SegmentModel,
    theta_scaled: Annotated[np.ndarray, "parameters lanes"],
    paths: Annotated[np.ndarray, "flights steps 12"],
) -> Annotated[np.ndarray, "flights steps memory lanes"]:
    """Return the states of the effects along the measured paths, every PATH_S, by CasADi step by step."""
    flights, steps = paths.shape[:2]
    lanes = theta_scaled.shape[1]
    program = segment_model.bind("memory", flights * lanes)
    program.inputs["z"][:] = np.repeat(theta_scaled, flights, axis=1)
    body = program.inputs["body"].reshape(STATES, -1, flights)
    memory = program.inputs["memory"]
    acceleration = program.inputs["acceleration"].reshape(3, -1, flights)
    body[:] = paths[:, 0].T[:, None]
    program()
    now = program.outputs["rest"].copy()
    states = np.empty((steps, segment_model.memory, lanes, flights))
    for k in range(steps):
        states[k] = now.reshape(states.shape[1:])
        memory[:] = now
        after = paths[:, min(k + 1, steps - 1)]
        body[:] = paths[:, k].T[:, None]
        acceleration[:] = (after - paths[:, k])[:, 3:6].T[:, None] / PATH_S
        program()
        memory[:] = now + 0.5 * PATH_S * program.outputs["rates"]
        body[:] = 0.5 * (paths[:, k] + after).T[:, None]
        program()
        now = now + PATH_S * program.outputs["rates"]
    return states.transpose(3, 0, 1, 2)


def residuals(
    data: Segments, predicted: Annotated[np.ndarray, "steps 12 lanes segments"]
) -> Annotated[np.ndarray, "lanes segments residuals"]:
    """Return measured minus predicted, in units of sigma; the 12 channels of each step follow each other.

    predicted: result of `roll_out`.
    """
    steps, _, lanes, segments = predicted.shape
    measured = np.concatenate([data.p_ned, np.zeros_like(data.p_ned), data.rate_frd, data.force_frd], axis=2)
    weights = (data.pose_weight, data.pose_weight, data.rate_weight, data.force_weight)
    scale = np.stack([w / data.sigma[:, i : i + 1] for i, w in enumerate(weights)], axis=2)
    out = measured - np.transpose(predicted, (2, 3, 0, 1))
    out *= np.repeat(scale, 3, axis=2)
    return out.reshape(lanes, segments, steps * CHANNELS)
