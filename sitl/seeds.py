"""Random generators for every purpose, each from its own branch of the seed.

What a world is comes from its seed alone; what differs between flights in one world from seed and flight
index. Keys are fixed numbers: a purpose added later changes none of the others.
"""

from __future__ import annotations

import hashlib
from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a generator is for. The numbers are part of the format: same seed, same bytes."""

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


_WORLD, _FLIGHT = 0, 1


def world_generator(world_seed: int, purpose: Purpose, index: int = 0) -> np.random.Generator:
    """Return a generator for drawing the world; `index` parts kinds that must not shift each other."""
    return _generator(world_seed, (_WORLD, purpose, index))


def flight_generator(world_seed: int, flight: int, purpose: Purpose) -> np.random.Generator:
    """Return a generator for one purpose of one flight."""
    return _generator(world_seed, (_FLIGHT, flight, purpose))


def _generator(seed: int, key: tuple[int, ...]) -> np.random.Generator:
    if seed < 0 or min(key) < 0:
        raise ValueError(f"seeds and flight indices are not negative, got seed {seed}, key {key}")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def session_uid(world_seed: int, flight: int) -> int:
    """64 bits, not 0, that name a session and look random.

    They do not show the seed, but whoever tries seeds one by one finds a small one.
    """
    digest = hashlib.sha256(f"trimtab session uid, seed {world_seed}, flight {flight}".encode()).digest()
    return int.from_bytes(digest[:8], "little") or 1
