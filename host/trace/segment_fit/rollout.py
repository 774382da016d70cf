"""Roll-outs of segments from many initial states, with many parameters and disturbances, as lanes."""

from __future__ import annotations

import numpy as np

from trimtab.host.trace.data.segments import BIN_S, PATH_S, Segments
from trimtab.host.trace.segment_fit.model import CHANNELS, LOCALS, STATES, SegmentModel


def roll_out(
    segment_model: SegmentModel,
    data: Segments,
    x0: np.ndarray,
    theta_scaled: np.ndarray,
    local: np.ndarray,
    bins: np.ndarray | None = None,
    memory: np.ndarray | None = None,
) -> np.ndarray:
    """Predicted measurements (H, 12, C, S) of lanes: `form.CHANNELS` of every step.

    x0 (12, C, S); theta_scaled (P, C); local (9, C, S); bins (bins, 6, C) disturbance, specific force
    m/s^2 then angular acceleration rad/s^2, both FRD. Motors start at the lagged command of the run-up, the
    effects' own states at `memory` (M, C, S); by default with what the measured flight made of them.
    """
    lanes, count = x0.shape[1:]
    total = lanes * count
    step, pre = segment_model.bind("step", total), data.command.shape[1] - data.steps
    inputs, outputs = step.inputs, step.outputs

    def load(name: str, value: np.ndarray) -> None:
        """Load an input of every segment (S,) or (S, n), the same in all lanes."""
        rows = value.T[:, None] if value.ndim == 2 else value
        inputs[name].reshape(-1, lanes, count)[:] = rows

    each = np.repeat(theta_scaled, count, axis=1)
    inputs["z"][:] = each
    inputs["body"][:] = x0.reshape(STATES, total)
    inputs["local"][:] = local.reshape(LOCALS, total)
    commands = _delayed(segment_model, data.command, theta_scaled)
    inputs["thrust"][:] = _spun_up(segment_model, commands[:pre], each)
    if segment_model.memory:
        memory = remembered(segment_model, data, theta_scaled) if memory is None else memory
        inputs["memory"][:] = memory.reshape(segment_model.memory, total)
    predicted = np.empty((data.steps, CHANNELS, lanes, count))
    per_bin = round(BIN_S / data.dt_s)
    w = inputs["w"].reshape(6, lanes, count)
    for k in range(data.steps):
        index = k // per_bin
        w[:] = data.disturbance_frd[:, index].T[:, None]
        if bins is not None:
            w += bins[index][:, :, None]
        inputs["command"][:] = commands[pre + k]
        load("attitude", data.R_ned_frd[:, k])
        load("rate", data.rate_frd[:, k])
        load("voltage", data.voltage_ratio[:, k])
        load("t_s", data.start_s + k * data.dt_s)
        load("shift_s", data.shift_s[:, k])
        step()
        predicted[k] = outputs["predicted_out"].reshape(CHANNELS, lanes, count)
        inputs["body"][:] = outputs["body_out"]
        inputs["thrust"][:] = outputs["thrust_out"]
        inputs["memory"][:] = outputs["memory_out"]
    return predicted


def _delayed(segment_model: SegmentModel, command: np.ndarray, theta_scaled: np.ndarray) -> np.ndarray:
    """Return commands (pre + H, 4, C S) as they arrive at theta_scaled (P, C), of those sent (S, pre + H, 4).

    Means over steps, so that a delay of a fraction of a step mixes two of them; before the first, the first.
    """
    each = []
    for delay in segment_model.delay_s(theta_scaled):
        whole, share = divmod(float(delay) / segment_model.dt_s, 1.0)
        at = np.clip(np.arange(command.shape[1]) - int(whole), 0, command.shape[1] - 1)
        now, before = command[:, at], command[:, np.maximum(at - 1, 0)]
        each.append((1.0 - share) * now + share * before if share else now)
    lanes = np.transpose(np.array(each), (2, 3, 0, 1))
    return lanes.reshape(*lanes.shape[:2], -1)


def _spun_up(segment_model: SegmentModel, commands: np.ndarray, theta_scaled: np.ndarray) -> np.ndarray:
    """Rotor thrusts (4, lanes) after commands (n, 4, lanes), begun where the first of them settles."""
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


def remembered(segment_model: SegmentModel, data: Segments, theta_scaled: np.ndarray) -> np.ndarray:
    """Return the effects' own states (M, C, S) at the segments' starts for theta_scaled (P, C).

    Along the measured paths of their flights.
    """
    if not segment_model.memory:
        return np.empty((0, theta_scaled.shape[1], len(data.flight)))
    own = [
        i for name, rows in segment_model.space.owners.items() if segment_model.memory_of(name) for i in rows
    ]
    kinds, lane = np.unique(theta_scaled[own], axis=1, return_inverse=True)
    values = np.repeat(theta_scaled[:, :1], kinds.shape[1], axis=1)
    values[own] = kinds
    flights, steps = data.paths.shape[:2]
    program = segment_model.bind("memory", flights * kinds.shape[1])
    program.inputs["z"][:] = np.repeat(values, flights, axis=1)
    body = program.inputs["body"].reshape(STATES, -1, flights)
    memory = program.inputs["memory"]
    acceleration = program.inputs["acceleration"].reshape(3, -1, flights)
    body[:] = data.paths[:, 0].T[:, None]
    program()
    now = program.outputs["rest"].copy()
    found = np.empty((steps, segment_model.memory, kinds.shape[1], flights))
    for k in range(steps):
        found[k] = now.reshape(found.shape[1:])
        memory[:] = now
        after = data.paths[:, min(k + 1, steps - 1)]
        body[:] = data.paths[:, k].T[:, None]
        acceleration[:] = (after - data.paths[:, k])[:, 3:6].T[:, None] / PATH_S
        program()
        memory[:] = now + 0.5 * PATH_S * program.outputs["rates"]
        body[:] = 0.5 * (data.paths[:, k] + after).T[:, None]
        program()
        now = now + PATH_S * program.outputs["rates"]
    at = data.path_start_s / PATH_S
    low = np.clip(at.astype(int), 0, steps - 2)
    share = np.clip(at - low, 0.0, 1.0)
    low, share = low[None, :], share[None, :, None]
    lane, flight = lane.reshape(-1, 1), data.flight[None, :]
    ends = [np.moveaxis(found, 1, 3)[low + end, lane, flight] for end in (0, 1)]
    return np.moveaxis((1.0 - share) * ends[0] + share * ends[1], 2, 0)


def residuals(data: Segments, predicted: np.ndarray) -> np.ndarray:
    """Measured minus predicted in units of their sigma, (C, S, 12 H), for `roll_out`'s (H, 12, C, S)."""
    steps, _, lanes, segments = predicted.shape
    measured = np.concatenate([data.p_ned, np.zeros_like(data.p_ned), data.rate_frd, data.force_frd], axis=2)
    weights = (data.pose_weight, data.pose_weight, data.rate_weight, data.force_weight)
    scale = np.stack([w / data.sigma[:, i : i + 1] for i, w in enumerate(weights)], axis=2)
    out = measured - np.transpose(predicted, (2, 3, 0, 1))
    out *= np.repeat(scale, 3, axis=2)
    return out.reshape(lanes, segments, steps * CHANNELS)
