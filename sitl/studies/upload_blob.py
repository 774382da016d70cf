"""The uploaded blob: a flyable reference with 399 nodes and one yaw node, 20,806 B."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import make_interp_spline

from trimtab.host.vehicle import load_vehicle
from trimtab.protocol.blobs import Node, Reference, YawNode

NODES, SPACING_S = 399, 0.1
_RAMP_S, _FINE = 3.0, 10
_OMEGA = 0.8


@lru_cache(maxsize=64)
def reference_blob(vehicle: str, number: int, nodes: int = NODES) -> bytes:
    """Return the bytes of a reference that depends on `number`.

    It is a lemniscate at 1.2 m with a gradual start and end, a node every 0.1 s (at least 61) and one yaw
    node.
    """
    t = np.arange(nodes) * SPACING_S
    fine = np.arange((nodes - 1) * _FINE + 1) * SPACING_S / _FINE
    x = np.clip(np.minimum(fine, fine[-1] - fine) / _RAMP_S, 0.0, 1.0)
    rate = x**5 * (126 - 420 * x + 540 * x**2 - 315 * x**3 + 70 * x**4)
    steps = 0.5 * (rate[1:] + rate[:-1]) * SPACING_S / _FINE
    phase = _OMEGA * np.concatenate([[0.0], np.cumsum(steps)])[::_FINE]
    size_m = 1.0 + 0.5 * (number % 1000) / 1000
    path = np.stack(
        [size_m * np.sin(phase), 0.5 * size_m * np.sin(2 * phase), -1.2 - 0.1 * (1 - np.cos(phase))], axis=1
    )
    spline = make_interp_spline(t, path, k=9)
    rows = np.hstack([spline(t, k) for k in range(4)])
    rows[0, 3:] = rows[-1, 3:] = 0.0
    states = tuple(
        Node(round(s * 1e6), tuple(map(float, row))) for s, row in zip(t.tolist(), rows, strict=True)
    )
    blob = Reference(
        vehicle_id=load_vehicle(vehicle).id,
        origin_ned=(0.0, 0.0, 0.0),
        nodes=states,
        yaws=(YawNode(0, 0.0, 0.0),),
    )
    return blob.to_bytes()
