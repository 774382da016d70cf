"""Offboard control: the newest setpoint, its bounds, and direct attitude and rate commands."""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.braking import Brakes, Room
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.setpoints import AttitudeTarget, Bounds, PositionTarget, Target
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.step import NO_OFFBOARD


class Offboard:
    """Holds the newest setpoint and writes the engine's block `offboard`.

    Attributes
    ----------
    target
        Newest setpoint, or None.
    setpoint_us
        Time of the newest setpoint.
    followed
        Target of the present track, or None.
    """

    def __init__(self, block: memoryview[float], parameters: ParameterValues) -> None:
        self._block = block
        self._parameters = parameters
        self.target: Target | None = None
        self.setpoint_us = -NEVER_US
        self.followed: PositionTarget | None = None
        self.release()

    @property
    def direct(self) -> bool:
        """Whether thrust with attitude or body rate is commanded directly, without a reference."""
        return self._block[0] > 0.5

    def is_receiving(self, now_us: int) -> bool:
        """Return whether setpoints arrive: the newest one is at most FS_OFFB_S old."""
        return now_us - self.setpoint_us <= self._parameters.us("FS_OFFB_S")

    def offer(self, target: Target, now_us: int) -> None:
        """Store `target` as the newest setpoint."""
        self.target, self.setpoint_us = target, now_us

    def release(self) -> None:
        """End direct commands: the law follows the reference again."""
        self.followed = None
        self._fill(NO_OFFBOARD)

    def command(self, target: AttitudeTarget) -> None:
        """Command thrust with attitude or body rate directly, within LIM_RATE_* and THRUST_FLOOR."""
        values = self._parameters
        thrust = 4.0 * values["THRUST_MAX"] * target.thrust
        thrust_min = values["THRUST_FLOOR"] * values["MASS"] * GRAVITY
        rate = [
            min(max(w, -values[name]), values[name])
            for w, name in zip(target.rate, ("LIM_RATE_X", "LIM_RATE_Y", "LIM_RATE_Z"), strict=True)
        ]
        weight, q = (0.0, NO_OFFBOARD[6:10]) if target.q is None else (1.0, target.q)
        self.followed = None
        self._fill((1.0, max(thrust, thrust_min), *rate, weight, *q))

    def room(self, floor: float) -> Room:
        """Return the box of references above a floor at this position (m, down)."""
        values = self._parameters
        low = (values["FENCE_N_MIN"], values["FENCE_E_MIN"], values["FENCE_D_MIN"])
        bottom = max(low[2], min(values["FENCE_D_MAX"], floor - values["OFFB_HEIGHT"]))
        return Room(low, (values["FENCE_N_MAX"], values["FENCE_E_MAX"], bottom))

    def bounds(self, floor: float, brakes: Brakes) -> Bounds:
        """Return the bounds of setpoints above a floor at this position (m, down)."""
        values = self._parameters
        return Bounds(
            room=self.room(floor),
            speed=values["LIM_SPEED"],
            accel=values["OFFB_ACCEL"],
            brakes=brakes._replace(gentle=values["OFFB_ACCEL"]),
            yaw_rate=values["LIM_RATE_Z"],
            turn_rate=min(values["OFFB_TURN"], values["LIM_RATE_Z"]),
        )

    def _fill(self, values: Sequence[float]) -> None:
        for k, value in enumerate(values):
            self._block[k] = value
