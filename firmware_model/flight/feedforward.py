"""Feed-forward as engine inputs: the block of coefficients (form a), and the network (form b) along the
reference.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Mapping, Sequence

from trimtab.firmware_model.law import feedforward as law
from trimtab.firmware_model.law.dfbc import FlatState
from trimtab.firmware_model.law.ops import FLOAT
from trimtab.firmware_model.law.step import flat_motion
from trimtab.protocol.blobs import FeedForward


class FeedForwardInput:
    """Writes the feed-forward blocks of the engine; they are neutral without a feed-forward.

    `update` evaluates the network and the gain at the battery voltage; both are constant in between. The law
    fades the residual acceleration out beyond the region of the blob.

    Parameters
    ----------
    inputs, outputs
        Blocks of the engine.
    """

    def __init__(
        self, inputs: Mapping[str, memoryview[float]], outputs: Mapping[str, memoryview[float]]
    ) -> None:
        self._block = inputs["feedforward"]
        self._accel, self._jerk = inputs["ff_accel_ned"], inputs["ff_jerk_ned"]
        self._reference, self._weight = outputs["reference"], outputs["ff_weight"]
        self._blob: FeedForward | None = None
        self._held = self._has_faded = False
        self.clear()

    @property
    def weight(self) -> float:
        """Weight of the residual acceleration: 1 inside the region, less beyond it."""
        return self._weight[0]

    def clear(self) -> None:
        """Turn the feed-forward off."""
        self._blob = None
        self._fill(self._block, law.NEUTRAL)
        self._fill_network(law.NO_RESIDUAL)

    def load(self, blob: FeedForward) -> None:
        """Apply this feed-forward."""
        self.clear()
        self._blob = blob
        self._fill(self._block, law.full_block(blob.block, blob.region))

    def hold(self, accel_ned: Sequence[float]) -> None:
        """Replace the network's output by this residual acceleration (m/s^2, NED) until `resume`; unfaded."""
        self._held = True
        self._fill_network(law.NO_RESIDUAL._replace(accel_ned=accel_ned))
        self._block[law.REGION] = memoryview(array("d", law.OPEN_REGION))

    def resume(self) -> None:
        """Use the network again; `update` reports the next fading."""
        self._held = self._has_faded = False
        self._fill_network(law.NO_RESIDUAL)
        self._fill_region()

    def update(self, voltage_ratio: float) -> bool:
        """Evaluate network and gain; return whether the feed-forward begins to fade for the first time.

        voltage_ratio: battery voltage over full voltage; one that is not measured (0 or not finite) leaves
        the gain as it is.
        """
        blob = self._blob
        if blob is None:
            return False
        if blob.block is not None and math.isfinite(voltage_ratio) and voltage_ratio > 0.0:
            exponent = blob.block[law.VOLTAGE_EXPONENT]
            self._block[law.GAIN] = law.gain_at_voltage(FLOAT, blob.block[law.GAIN], exponent, voltage_ratio)
        if blob.layers and not self._held:
            ref = self._reference.tolist()
            state = FlatState(ref[0:3], ref[3:6], ref[6:9], ref[9:12], ref[12], ref[13])
            motion, _ = flat_motion(FLOAT, state)
            self._fill_network(
                law.network_residual(
                    FLOAT,
                    blob.weights,
                    blob.layers,
                    motion,
                    body_frame=blob.body_frame,
                    with_jerk=blob.feeds_jerk,
                )
            )
        begins = self.weight < 1.0 and not self._has_faded
        self._has_faded |= begins
        return begins

    def _fill_region(self) -> None:
        region = None if self._blob is None else self._blob.region
        self._block[law.REGION] = memoryview(array("d", law.OPEN_REGION if region is None else region))

    def _fill_network(self, residual: law.Residual) -> None:
        self._fill(self._accel, residual.accel_ned)
        self._fill(self._jerk, residual.jerk_ned)

    @staticmethod
    def _fill(view: memoryview[float], values: Sequence[float]) -> None:
        for k, value in enumerate(values):
            view[k] = value
