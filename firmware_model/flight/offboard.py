"""The newest setpoint: what a track to it is kept within, or the commands that take a track's place."""

from __future__ import annotations

from collections.abc import Sequence

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.braking import Room
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.setpoints import AttitudeTarget, Bounds, PositionTarget, Target
from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.step import NO_OFFBOARD


class Offboard:
    """Keeps the engine's block `offboard`.

    `heard_us` is when the last setpoint came. `direct`: attitude and thrust are commanded, no reference is
    followed. `followed` is the target that the present track leads to, None where there is none.
    """

    def __init__(self, block: memoryview[float], parameters: ParameterValues) -> None:
        self._block = block
        self._parameters = parameters
        self.target: Target | None = None
        self.heard_us = -NEVER_US
        self.followed: PositionTarget | None = None
        self.release()

    @property
    def direct(self) -> bool:
        """Whether attitude or rate and thrust are commanded."""
        return self._block[0] > 0.5

    def arriving(self, now_us: int) -> bool:
        """Whether setpoints are coming in."""
        return now_us - self.heard_us <= self._parameters.us("FS_OFFB_S")

    def offer(self, target: Target, now_us: int) -> None:
        """Make this the newest setpoint."""
        self.target, self.heard_us = target, now_us

    def release(self) -> None:
        """Follow the reference again."""
        self.followed = None
        self._fill(NO_OFFBOARD)

    def drive(self, target: AttitudeTarget) -> None:
        """Command this attitude or rate and this thrust, within the law's limits."""
        values = self._parameters
        thrust = 4.0 * values["THRUST_MAX"] * target.thrust
        least = values["THRUST_FLOOR"] * values["MASS"] * GRAVITY
        rate = [
            min(max(w, -values[name]), values[name])
            for w, name in zip(target.rate, ("LIM_RATE_X", "LIM_RATE_Y", "LIM_RATE_Z"), strict=True)
        ]
        weight, q = (0.0, NO_OFFBOARD[6:10]) if target.q is None else (1.0, target.q)
        self.followed = None
        self._fill((1.0, max(thrust, least), *rate, weight, *q))

    def bounds(self, floor: float) -> Bounds:
        """Return what positions and velocities are kept within, above a floor at this height (m, down)."""
        values = self._parameters
        low = (values["FENCE_N_MIN"], values["FENCE_E_MIN"], values["FENCE_D_MIN"])
        bottom = max(low[2], min(values["FENCE_D_MAX"], floor - values["OFFB_HEIGHT"]))
        return Bounds(
            room=Room(low, (values["FENCE_N_MAX"], values["FENCE_E_MAX"], bottom)),
            speed=values["LIM_SPEED"],
            accel=values["OFFB_ACCEL"],
            yaw_rate=values["LIM_RATE_Z"],
            turn_rate=min(values["OFFB_TURN"], values["LIM_RATE_Z"]),
        )

    def _fill(self, values: Sequence[float]) -> None:
        for k, value in enumerate(values):
            self._block[k] = value
