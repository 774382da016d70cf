"""A made-up flight, consistent by construction, for the writers of foreign logs.

The conversions here are not those of trimtab.host.imports: rotations are composed from half turns by scipy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

G = 9.80665
RATE_HZ = 100
HALF_TURN_ABOUT_X = Rotation.from_rotvec([np.pi, 0.0, 0.0])
HALF_TURN_ABOUT_NORTH_EAST = Rotation.from_rotvec(np.pi * np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0))
"""What swaps north with east and up with down: ENU to NED and back."""

WORLDS = {"ned": Rotation.identity(), "nwu": HALF_TURN_ABOUT_X, "enu": HALF_TURN_ABOUT_NORTH_EAST}
BODIES = {"frd": Rotation.identity(), "flu": HALF_TURN_ABOUT_X}


@dataclass(frozen=True, kw_only=True)
class MadeUp:
    """Take-off, eight seconds of moves, landing. t (n,) s; p (n, 3) NED m; turn R_ned_frd; gyro and force
    (n, 3) FRD; motor (n, 4) 0..1, each motor its own; thrust (n,) N; volt (n,).
    """

    t: np.ndarray
    p: np.ndarray
    turn: Rotation
    gyro: np.ndarray
    force: np.ndarray
    motor: np.ndarray
    thrust: np.ndarray
    volt: np.ndarray

    def cut(self, rows: slice) -> MadeUp:
        """The same flight, some of its rows."""
        return MadeUp(**{name: value[rows] for name, value in vars(self).items()})


def _smooth(x: np.ndarray) -> np.ndarray:
    """0 to 1 with three derivatives zero at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


@lru_cache(maxsize=1)
def made_up() -> MadeUp:
    """The flight; from 3 to 9 s at one height, in smooth moves."""
    fine = 10
    t = np.arange(0.0, 13.0, 1.0 / (RATE_HZ * fine))
    up = _smooth((t - 1.0) / 1.5) - _smooth((t - 10.5) / 1.5)
    away = _smooth((t - 2.5) / 1.0) - _smooth((t - 9.5) / 1.0)
    north, east = 0.8 * away * np.sin(2.1 * t), 0.6 * away * np.sin(1.3 * t + 0.4)
    p = np.column_stack([north, east, -1.2 * up])
    yaw = 0.5 * away * np.sin(0.9 * t)
    dt = t[1] - t[0]
    a = np.gradient(np.gradient(p, dt, axis=0), dt, axis=0)
    push = a - [0.0, 0.0, G]
    down = -push / np.linalg.norm(push, axis=1)[:, None]
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(t))])
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right, axis=1)[:, None]
    R = np.stack([np.cross(right, down), right, down], axis=2)
    turn = Rotation.from_matrix(R)
    rate = np.zeros((len(t), 3))
    rate[1:-1] = (turn[:-2].inv() * turn[2:]).as_rotvec() / (2.0 * dt)
    flying = (t > 0.9) & (t < 12.1)
    share = np.linalg.norm(push, axis=1) / G
    motor = np.where(flying[:, None], 0.5 * share[:, None] + 0.02 * rate[:, [0, 1, 2, 0]], 0.0)
    motor += np.where(flying[:, None], np.array([0.0, 0.01, 0.02, 0.03]), 0.0)
    every = slice(0, len(t), fine)
    jitter = np.random.default_rng(5).normal(0.0, 1e-5, (len(t), 3))
    return MadeUp(
        t=t[every],
        p=(p + jitter)[every],
        turn=turn[every],
        gyro=rate[every],
        force=np.einsum("nji,nj->ni", R, push)[every],
        motor=motor[every],
        thrust=np.where(flying, 0.033 * G * share, 0.0)[every],
        volt=(4.1 - 0.03 * t)[every],
    )


def in_axes(flight: MadeUp, world: str, body: str) -> MadeUp:
    """The same flight told in other axes."""
    to_world, to_body = WORLDS[world], BODIES[body]
    return MadeUp(
        t=flight.t,
        p=to_world.apply(flight.p),
        turn=to_world * flight.turn * to_body.inv(),
        gyro=to_body.apply(flight.gyro),
        force=to_body.apply(flight.force),
        motor=flight.motor,
        thrust=flight.thrust,
        volt=flight.volt,
    )
