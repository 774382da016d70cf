"""The effective parameters of a sealed world: the noise-free fit of the library's forms to its plant.

The plant is somebody else's physics, so its own numbers are no truth for a form of the library. From states
and with motor commands of the world's own flights the plant runs for a tenth of a second, without noise, once
with the world's effects and once without; the library's form, run from the same states with the same
commands, is fitted by least squares to the difference in specific force and body rate.

What acts on the measurement alone (a late or turned pose), on the command alone (a delay) or has states of
its own (a pendulum) leaves no such difference or needs no fit: there the plant's number and the form's are
defined alike, and the drawn one is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from host.effects import Effect
from host.log import Flight
from host.trace import segments
from host.trace.data import DT_S, segments_of
from host.trace.form import LOCALS, Form
from host.trace.parameters import Space
from host.trace.segments import Segments
from host.vehicle import Vehicle
from sitl.draw import World
from sitl.plant import Plant
from sitl.plant_model import STATE, TICK_S
from sitl.surroundings import GRAVITY_M_S2
from sitl.world import ImuSettings, MocapSettings, RadioSettings, Turbulence

Values = dict[str, dict[str, float]]

RUN_S = 0.1
MOST_SEGMENTS = 240
FORCE, RATE = 0.04, 0.02
"""Scales of the difference: specific force, m/s^2, and body rate, rad/s, of usual turbulence over RUN_S."""

_FITTED = (
    "mass_factor",
    "thrust_factor",
    "rotor_factors",
    "inertia_factors",
    "wind_ned",
    "specific_force_frd",
    "torque_frd",
    "motor_lag_s",
)
_PASSES = 6
_TICKS = round(DT_S / TICK_S)
_AT = dict(zip((b.name for b in STATE), np.cumsum([0, *(b.size for b in STATE)]).tolist(), strict=False))


def is_fitted(effect: Effect) -> bool:
    """Whether the effective parameters of an effect come from a fit; else they are the drawn ones."""
    return not effect.memory and any(getattr(effect, slot) is not None for slot in _FITTED)


def effective(
    vehicle: Vehicle, drawn: Mapping[str, Mapping[str, float]], space: Space, flights: Sequence[Flight]
) -> Values:
    """Effective parameters by effect and key of the drawn effects that `space` has a form of.

    drawn: the world's effects with the plant's numbers. flights: the world's flights; they say where in the
    space of states and commands the fit is made.
    """
    out = {name: dict(values) for name, values in drawn.items() if name in space.effects}
    fitted = [name for name in out if is_fitted(space.effects[name])]
    # Only what was drawn off neutral is fitted: one rotor of four, not four.
    columns = [
        i
        for name in fitted
        for i in space.owners[name]
        if drawn[name].get(space.columns[i].key, space.columns[i].neutral) != space.columns[i].neutral
    ]
    if not columns:
        return out
    data = _envelope(flights)
    world = {name: values for name, values in drawn.items() if name in fitted}
    changed, voltage_ratio = plant_response(vehicle, world, data)
    nominal, _ = plant_response(vehicle, {}, data)
    data = replace(data, voltage_ratio=voltage_ratio)
    z = fit(vehicle, space, data, changed - nominal, columns, _start(space, drawn, columns))
    values = space.values(z)
    for i in columns:
        out[space.columns[i].owner][space.columns[i].key] = float(values[i])
    return out


def _envelope(flights: Sequence[Flight]) -> Segments:
    """Segments of RUN_S from all flights, evenly thinned to MOST_SEGMENTS, disturbance and biases nil."""
    data, _ = segments_of(flights, segment_s=RUN_S)
    count = len(data.flight)
    return data.take(np.unique(np.linspace(0, count - 1, min(count, MOST_SEGMENTS)).round().astype(int)))


def _start(space: Space, drawn: Mapping[str, Mapping[str, float]], columns: Sequence[int]) -> np.ndarray:
    """Scaled parameters (P,) at the drawn numbers of the fitted columns, all others neutral."""
    z = np.zeros(len(space.columns))
    for i in columns:
        column = space.columns[i]
        z[i] = (drawn[column.owner][column.key] - column.neutral) / column.scale
    return z


def plant_response(
    vehicle: Vehicle, effects: Mapping[str, Mapping[str, float]], data: Segments
) -> tuple[np.ndarray, np.ndarray]:
    """Specific force and body rate (S, H, 6), and voltage over full (S, H), of the plant without noise.

    Means over the data's steps, FRD, from the data's states (x0) under its motor commands. The battery stands
    where it has the logged voltage at hover.
    """
    plant = Plant(vehicle, _still(effects), 0)
    state = plant.state
    c1, c2 = vehicle.thrust_curve
    depths, volts = _discharge(plant, vehicle)
    pre = data.command.shape[1] - data.steps
    response = np.empty((len(data.flight), data.steps, 6))
    ratio = np.empty(response.shape[:2])
    for s, x in enumerate(data.x0):
        q = Rotation.from_euler("ZYX", x[[8, 7, 6]]).as_quat()[[3, 0, 1, 2]].tolist()
        p = x[:3].tolist()
        commands = data.command[s].tolist()
        charge = float(np.interp(-data.voltage_ratio[s].mean() * vehicle.battery.full_v, -volts, depths))
        plant.reset([p[0], p[1], -100.0], [1.0, 0.0, 0.0, 0.0])
        _put(state, "rotor_speed", [max(u * (c1 + c2 * u), 0.0) ** 0.5 for u in commands[0]])
        _put(state, "charge_used_c", [charge])
        for command in commands[:pre]:
            for _ in range(_TICKS):
                plant.step(command)
        speeds = [state[_AT["rotor_speed"] + i] for i in range(4)]
        plant.reset(p, q)
        _put(state, "rotor_speed", speeds)
        _put(state, "charge_used_c", [charge])
        _put(state, "v_ned", x[3:6].tolist())
        _put(state, "rate_frd", x[9:12].tolist())
        sensed = np.empty((data.steps * _TICKS, 7))
        for k, command in enumerate(commands[pre:]):
            for i in range(_TICKS):
                plant.step(command)
                sensed[k * _TICKS + i] = plant.sensed
        means = sensed.reshape(data.steps, _TICKS, 7).mean(1)
        response[s] = means[:, [3, 4, 5, 0, 1, 2]]
        ratio[s] = means[:, 6] / vehicle.battery.full_v
    return response, ratio


def _still(effects: Mapping[str, Mapping[str, float]]) -> World:
    """A world with these effects, no deviation of the build and still air."""
    return World(
        name="still",
        seed=0,
        effects=effects,
        deviations={},
        turbulence=Turbulence(force_m_s2=0.0, torque_rad_s2=0.0),
        mocap=MocapSettings(),
        imu=ImuSettings(),
        radio=RadioSettings(),
    )


def _discharge(plant: Plant, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Charges used, C, and the plant's voltage at hover with each, falling; level in a world without sag."""
    hover = (vehicle.mass_kg * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n)) ** 0.5
    charges = np.linspace(0.0, 0.95, 96) * vehicle.battery.capacity_ah * 3600.0
    volts = []
    for charge in charges:
        plant.reset([0.0, 0.0, -100.0], [1.0, 0.0, 0.0, 0.0])
        _put(plant.state, "rotor_speed", [hover] * 4)
        _put(plant.state, "charge_used_c", [charge])
        plant.step([0.0] * 4)
        volts.append(plant.sensed[6])
    return charges, np.array(volts)


def _put(state: Any, block: str, values: Sequence[float]) -> None:
    for i, value in enumerate(values):
        state[_AT[block] + i] = value


def host_response(vehicle: Vehicle, space: Space, data: Segments, z: np.ndarray) -> np.ndarray:
    """What `plant_response` is, of the library's form: (lanes, S, H, 6) for scaled z (P, lanes)."""
    lanes = z.shape[1]
    x0 = np.repeat(data.x0.T[:, None, :], lanes, axis=1)
    local = np.zeros((LOCALS, lanes, len(data.flight)))
    form = Form(vehicle, space, dt_s=data.dt_s, in_newton=data.in_newton, rate_driven=data.rate_driven)
    found = segments.roll_out(form, data, x0, z, local)
    return np.transpose(found[:, [9, 10, 11, 6, 7, 8]], (2, 3, 0, 1))


def fit(
    vehicle: Vehicle,
    space: Space,
    data: Segments,
    difference: np.ndarray,
    columns: Sequence[int],
    z: np.ndarray,
) -> np.ndarray:
    """Scaled parameters (P,) from z on whose `columns` bring the form nearest to `difference` (S, H, 6)."""
    weight = np.array([1.0 / FORCE] * 3 + [1.0 / RATE] * 3)
    step = 1e-4
    for _ in range(_PASSES):
        lanes = np.repeat(z[:, None], 2 + len(columns), axis=1)
        lanes[:, 1] = 0.0
        lanes[list(columns), np.arange(2, 2 + len(columns))] += step
        found = host_response(vehicle, space, data, lanes)
        rest = ((difference - (found[0] - found[1])) * weight).ravel()
        slopes = np.stack([((lane - found[0]) * weight).ravel() / step for lane in found[2:]], axis=1)
        move = np.linalg.lstsq(slopes, rest, rcond=None)[0]
        z = z.copy()
        z[list(columns)] += move
        z = space.clipped(z)
        if np.abs(move).max() < 1e-4:
            break
    return z
