"""Feed-forward as engine inputs: the block of coefficients (form a), and the network (form b) along the
reference.
"""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.firmware_model.law import feedforward as law
from trimtab.firmware_model.law.flatness import flat_attitude
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.rotations import matrix_to_euler
from trimtab.protocol.blobs import FeedForward


class FeedForwardInput:
    """Writes the engine's blocks `feedforward` and `ff_accel_ned`; they are neutral without a feed-forward.

    `update` evaluates the network; its output is constant in between.
    """

    def __init__(self, block: memoryview[float], accel_ned: memoryview[float]) -> None:
        self._block = block
        self._accel = accel_ned
        self._hidden: tuple[int, ...] = ()
        self._weights: tuple[float, ...] = ()
        self._held = False
        self.clear()

    def clear(self) -> None:
        """Turn the feed-forward off."""
        self._fill(self._block, law.NEUTRAL)
        self._fill(self._accel, (0.0, 0.0, 0.0))
        self._hidden = self._weights = ()

    def load(self, blob: FeedForward) -> None:
        """Apply this feed-forward."""
        self.clear()
        if blob.block is not None:
            self._fill(self._block, blob.block)
        self._hidden, self._weights = blob.layers, blob.weights

    def hold(self, accel_ned: Sequence[float]) -> None:
        """Replace the network's output by this residual acceleration (m/s^2, NED) until `resume`."""
        self._held = True
        self._fill(self._accel, accel_ned)

    def resume(self) -> None:
        """Use the network again."""
        self._held = False
        self._fill(self._accel, (0.0, 0.0, 0.0))

    def update(self, reference: Sequence[float]) -> None:
        """Evaluate the network on this reference (p, v, a, j in NED, yaw, yaw rate)."""
        if self._hidden and not self._held:
            R, _ = flat_attitude(FLOAT, reference[6:9], reference[12])
            rpy = matrix_to_euler(FLOAT, R)
            self._fill(self._accel, law.network(FLOAT, self._weights, self._hidden, reference[3:6], rpy))

    @staticmethod
    def _fill(view: memoryview[float], values: Sequence[float]) -> None:
        for k, value in enumerate(values):
            view[k] = value
