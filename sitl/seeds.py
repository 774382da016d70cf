"""Random generators, one for each purpose, from separate branches of the seed.

A world depends on its seed alone. Differences between flights in a world depend on seed and flight index.
Keys are fixed numbers, so adding a purpose does not change the others.
"""

from __future__ import annotations

import hashlib
from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """Purpose of a generator. The numbers must not change, so that the same seed gives the same bytes."""

    KINDS = 0
    SIZES = 1
    TOLERANCES = 2
    TURBULENCE = 16
    IMU = 17
    MOCAP = 18
    RADIO_UP = 19
    RADIO_DOWN = 20
    BATTERY = 21
    FOREIGN_PLANT = 22
    TIMING = 23
    PHASES = 24
    ROTOR_SPEED = 25


_WORLD, _FLIGHT = 0, 1


def world_generator(world_seed: int, purpose: Purpose, index: int = 0) -> np.random.Generator:
    """Return a generator for drawing the world; `index` separates kinds that must not affect each other."""
    return _generator(world_seed, (_WORLD, purpose, index))


def flight_generator(world_seed: int, flight: int, purpose: Purpose) -> np.random.Generator:
    """Return a generator for one purpose of one flight."""
    return _generator(world_seed, (_FLIGHT, flight, purpose))


def _generator(seed: int, key: tuple[int, ...]) -> np.random.Generator:
    if seed < 0 or min(key) < 0:
        raise ValueError(f"seeds and flight indices must not be negative, got seed {seed}, key {key}")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def session_uid(world_seed: int, flight: int, *, at_port: bool = False) -> int:
    """Return a 64-bit id of a session that looks random and is not 0.

    at_port: whether the vehicle is served at a port, in real time. It then flies differently with the same
    seed, so the session is another one.

    It does not reveal the seed directly, but a small seed can be found by trying.
    """
    named = f"trimtab session uid, seed {world_seed}, flight {flight}{', at a port' if at_port else ''}"
    digest = hashlib.sha256(named.encode()).digest()
    return int.from_bytes(digest[:8], "little") or 1
