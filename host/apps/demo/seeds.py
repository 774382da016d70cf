"""The two seeds of a demo: the host's, which logs may contain, and the world's, which they must not.

Both are separate hashes of the demo's seed, so neither reveals the other.
"""

from __future__ import annotations

import hashlib


def host_seed(seed: int) -> int:
    """Return the seed of routes and plans, below 2^32."""
    return _hash("host", seed, 4)


def world_seed(seed: int) -> int:
    """Return the seed of the simulated world, below 2^63."""
    return _hash("world", seed, 8) >> 1


def _hash(purpose: str, seed: int, size: int) -> int:
    digest = hashlib.sha256(f"trimtab demo, {purpose} seed, {seed}".encode()).digest()
    return int.from_bytes(digest[:size], "big")
