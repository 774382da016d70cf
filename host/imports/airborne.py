"""Detection of the times that a foreign vehicle was airborne, from its poses and any recorded inputs."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

import numpy as np

from trimtab.host.imports.recording import Recording, TooShort

CLEAR_M = 0.15
"""Height above the ground from which a vehicle counts as airborne."""

EDGE_US = 500_000
"""Time left out after take-off and before landing, because of ground effect and a settling controller."""

SHORTEST_US = 2_000_000

UNSEEN_US = 5_000_000
"""Time without poses after which another flight begins: the vehicle was not seen, or a clock jumped."""

_REST_US = 300_000
_REST_M = 0.02
_POWERED = 0.3


def airborne(recording: Recording) -> tuple[tuple[int, int], ...]:
    """Return begin and end, us, of each time in the air of at least two seconds, in order.

    The ground is the lowest height, provided that the vehicle rests there with its motors off. A log in which
    it never does counts as airborne throughout. Where the vehicle was not seen for `UNSEEN_US`, only the side
    with the longest time in the air counts. Raises TooShort if no time in the air lasts two seconds.
    """
    t_us = recording.pose_us
    height = -recording.p_ned[:, 2]
    powered = _powered(recording)
    if powered is not None and not powered.any():
        raise TooShort(f"{recording.source}: the motors never run; import a log of a flight")
    flying = np.ones(len(t_us), dtype=bool) if powered is None else powered
    if _grounded(recording, height, ground_height(height), powered):
        flying = flying & above_ground(height)
    spans = [
        (
            int(t_us[a]) + (EDGE_US if a > 0 else 0),
            int(t_us[b - 1]) - (EDGE_US if b < len(t_us) else 0),
        )
        for a, b in _runs(flying, t_us)
    ]
    begin, end = max(spans, key=lambda span: span[1] - span[0], default=(0, 0))
    if end - begin < SHORTEST_US:
        raise TooShort(
            f"{recording.source}: airborne for {max(end - begin, 0) * 1e-6:.1f} s, but "
            f"{SHORTEST_US * 1e-6:g} s are needed; import a longer flight"
        )
    unseen_us = t_us[np.flatnonzero(np.diff(t_us) > UNSEEN_US)]
    side = np.searchsorted(unseen_us, begin)
    return tuple((a, b) for a, b in spans if b - a >= SHORTEST_US and np.searchsorted(unseen_us, a) == side)


def ground_height(height: Annotated[np.ndarray, "poses"]) -> float:
    """Return the lowest height, m, that is more than a stray pose."""
    return float(np.quantile(height, 0.01))


def above_ground(height: Annotated[np.ndarray, "poses"]) -> Annotated[np.ndarray, "poses"]:
    """Return the mask of the heights, m, at which a vehicle is clear of the lowest one."""
    return height > ground_height(height) + CLEAR_M


def far_from_ground(
    t_us: Annotated[np.ndarray, "poses"], height: Annotated[np.ndarray, "poses"]
) -> Annotated[np.ndarray, "poses"]:
    """Return the mask of the times at which a vehicle is clear of the ground and no landing is near."""
    low_us = np.concatenate([[-np.inf], t_us[~above_ground(height)], [np.inf]])
    after = np.searchsorted(low_us, t_us)
    return np.minimum(t_us - low_us[after - 1], low_us[after] - t_us) > EDGE_US


def _runs(flying: np.ndarray, t_us: np.ndarray) -> list[tuple[int, int]]:
    """Return (first row, row after the last) of each time in the air, joined over short breaks.

    A time ends where no pose follows for `UNSEEN_US`.
    """
    edges = np.flatnonzero(np.diff(np.r_[False, flying, False].astype(int)))
    runs: list[tuple[int, int]] = []
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if runs and t_us[a] - t_us[runs[-1][1] - 1] < _REST_US:
            a = runs.pop()[0]
        runs.append((a, b))
    unseen = np.flatnonzero(np.diff(t_us) > UNSEEN_US) + 1
    parts: list[tuple[int, int]] = []
    for a, b in runs:
        inner = unseen[(unseen > a) & (unseen < b)].tolist()
        parts += pairwise([a, *inner, b])
    return parts


def _powered(recording: Recording) -> np.ndarray | None:
    """Return whether the rotors produce thrust at each pose (n,); None without recorded inputs."""
    if recording.motor_command is not None:
        thrust = recording.motor_command.mean(axis=1)
    elif recording.thrust_n is not None:
        thrust = recording.thrust_n
    else:
        return None
    assert recording.input_us is not None
    full = float(np.quantile(thrust, 0.9))
    if full <= 0.0:
        return np.zeros(len(recording.pose_us), dtype=bool)
    # Thrust may be cut briefly in flight, so the maximum over the duration of a rest counts.
    width = max(1, round(_REST_US / float(np.median(np.diff(recording.input_us)))))
    padded = np.pad(thrust, (width // 2, width - 1 - width // 2), mode="edge")
    greatest = np.lib.stride_tricks.sliding_window_view(padded, width).max(axis=1)
    return np.interp(recording.pose_us, recording.input_us, greatest) > _POWERED * full


def _grounded(recording: Recording, height: np.ndarray, floor: float, powered: np.ndarray | None) -> bool:
    """Return whether the vehicle rests at the lowest height at some time with its motors off."""
    t_us, p = recording.pose_us, recording.p_ned
    if powered is None and np.ptp(height) < CLEAR_M < np.ptp(p[:, :2], axis=0).max():
        return False  # level flight, recorded in the air
    off = height < floor + 0.5 * CLEAR_M
    if powered is not None:
        off &= ~powered
    for a in np.flatnonzero(off & np.r_[True, ~off[:-1]]):
        stop = np.flatnonzero(~off[a:])
        b = a + int(stop[0]) if len(stop) else len(t_us)
        ends = np.searchsorted(t_us[a:b], t_us[a:b] + _REST_US)
        for k in range(0, b - a, max(1, (b - a) // 200)):
            window = p[a + k : a + int(ends[k])]
            whole = a + int(ends[k]) < len(t_us) and ends[k] < b - a
            if whole and np.ptp(window, axis=0).max() < _REST_M:
                return True
    return False
