"""The residual that a plan minimises: what a model predicts beyond the nominal vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from trimtab.firmware_model.law.constants import GRAVITY
from trimtab.firmware_model.law.ops import Ops
from trimtab.host.codegen import NUMPY
from trimtab.host.effects import Effect
from trimtab.host.models.airframe import RATE, STATE_SIZE, THETA, THRUST, P, Part, V
from trimtab.host.models.model import Model
from trimtab.host.models.network import Network
from trimtab.host.models.region import Region
from trimtab.host.models.residual import residual_acceleration_ned, residual_loads
from trimtab.host.vehicle import Vehicle

Array = NDArray[np.float64]

_HIGH_M = 100.0
"""Height of the state of rest: beyond the effect of the floor, which a path can avoid."""
_ROUNDING = 1e-6
"""m/s^2 by which a constant residual may vary for rounding."""


@dataclass(frozen=True, kw_only=True)
class ResidualModel:
    """A model beyond the nominal vehicle: effects with values, a network on top, and where both hold.

    adjusted: the effects that only moved within their tolerance. They are part of every prediction, but no
    plan avoids them: their changes of thrust, mass and torque count as known. Beside a network or a drag, so
    do all effects without specific force, because avoiding those brought no flight closer to its plan
    (docs/concepts/planning.md).
    """

    parts: tuple[Part, ...] = ()
    adjusted: frozenset[str] = frozenset()
    network: Network | None = None
    region: Region | None = None
    id: str | None = None

    @classmethod
    def of(cls, model: Model, effects: Mapping[str, Effect]) -> ResidualModel:
        """Return the residual model of a model file. Raises ValueError for unknown effects."""
        return cls(
            parts=tuple(model.parts(effects)),
            adjusted=frozenset(model.adjustments),
            network=model.network,
            region=model.region,
            id=model.id,
        )

    @property
    def _known(self) -> frozenset[str]:
        """Names of the effects whose loads no plan avoids."""
        if not self.has_force:
            return self.adjusted
        return self.adjusted | {part[0].name for part in self.parts if part[0].specific_force_frd is None}

    @property
    def has_force(self) -> bool:
        """Whether an effect beyond tolerance, such as a drag, or a network predicts a force."""
        forces = {effect.name for effect, _ in self.parts if effect.specific_force_frd}
        return self.network is not None or bool(forces - self.adjusted)

    def has_residual(self, vehicle: Vehicle) -> bool:
        """Return whether a path can change the predicted residual.

        It can with a network, and with effects beyond tolerance whose residual depends on the state.
        """
        return self.network is not None or bool((self._spread(vehicle) > _ROUNDING).any())

    def has_acceleration(self, vehicle: Vehicle) -> bool:
        """Return whether a path can change the predicted residual acceleration, torque aside."""
        return self.network is not None or bool((self._spread(vehicle)[:3] > _ROUNDING).any())

    def _spread(self, vehicle: Vehicle) -> Array:
        """Return the range (3 or 6,) of each row over some states, of the effects beyond tolerance."""
        named = ResidualModel(parts=tuple(part for part in self.parts if part[0].name not in self.adjusted))
        if not named.parts:
            return np.zeros(6)  # without importing numpy.random for the states
        return np.ptp(named._values(vehicle, _sample_states(vehicle)), axis=1)

    def rows(
        self, ops: Ops, vehicle: Vehicle, x: Sequence[Any], parts: Sequence[Part] | None = None
    ) -> list[Any]:
        """Return the effects' residual, m/s^2: their change of the nominal vehicle's acceleration at x.

        The first 3 rows are NED. Where an effect beyond tolerance can change the torque, 3 more rows about
        the body axes follow: that torque over arm length and mass, which is the acceleration by a force that
        gives this torque at an arm's end. All axes share one arm, the rotors' mean distance from the z axis:
        the rows measure how far the vehicle is turned, not how much its rotors must do to turn it back.

        x: state as in `trimtab.host.models`, thrusts in N. parts: instead of the model's, the same effects
        with values of another arithmetic.
        """
        parts = self.parts if parts is None else parts
        d = residual_acceleration_ned(ops, vehicle, parts, x)
        avoidable = [(_without_form_torque(effect), theta) for effect, theta in parts]
        known = [part for part in avoidable if part[0].name in self._known]
        acceleration, torque = residual_loads(ops, vehicle, avoidable, known, x)
        if acceleration is not None:
            d = [a + b for a, b in zip(d, acceleration, strict=True)]
        arm_m = float(np.mean([np.hypot(*rotor.position_m[:2]) for rotor in vehicle.rotors]))
        return [*d, *(tau / (arm_m * vehicle.mass_kg) for tau in torque or ())]

    def along(
        self, vehicle: Vehicle, x: Annotated[np.ndarray, "16 samples"]
    ) -> Annotated[np.ndarray, "_ samples"]:
        """Return the residual with the network's at states, for figures: 3 or 6 rows.

        Changes of thrust, mass and torque are relative to hover, where the law's trim compensates them.
        """
        hover = _hover(vehicle, 0.0)[:, None]
        trim = self._values(vehicle, hover)
        trim[:3] -= self._force(vehicle, hover)
        d = self._values(vehicle, x) - trim
        if self.network is not None:
            d[:3] += self.network.acceleration_ned(x[V], x[THETA])
        return d

    def at_rest(self, vehicle: Vehicle, yaw: float) -> Annotated[np.ndarray, "6"]:
        """Return the rows of the residual of the nominal vehicle at rest, which no plan avoids.

        The network is included. Forces are taken at the world's origin, loads far from the floor.
        """
        high = _hover(vehicle, yaw)[:, None]
        origin = high.copy()
        origin[P] = 0.0
        d = self._values(vehicle, high)
        d[:3] += self._force(vehicle, origin) - self._force(vehicle, high)
        if self.network is not None:
            d[:3] += self.network.acceleration_ned(high[V], high[THETA])
        return np.concatenate([d[:, 0], np.zeros(6 - len(d))])

    def _force(self, vehicle: Vehicle, x: Array) -> Array:
        """Return the acceleration (3, 1) by the effects' forces at a state (16, 1)."""
        return np.array(residual_acceleration_ned(NUMPY, vehicle, self.parts, list(x))).reshape(3, 1)

    def _values(self, vehicle: Vehicle, x: Array) -> Array:
        """Return the rows (3 or 6, n) without the network at states (16, n)."""
        rows = self.rows(NUMPY, vehicle, list(x))
        return np.array([np.broadcast_to(row, x.shape[1:]) for row in rows], dtype=float)


def _without_form_torque(effect: Effect) -> Effect:
    return replace(effect, torque_frd=None) if effect.form_torque else effect


def _hover(vehicle: Vehicle, yaw: float) -> Array:
    """Return the state (16,) of the nominal vehicle at rest, thrusts in N."""
    x = np.zeros(STATE_SIZE)
    x[P.stop - 1], x[THETA.stop - 1], x[THRUST] = -_HIGH_M, yaw, vehicle.mass_kg * GRAVITY / 4.0
    return x


def _sample_states(vehicle: Vehicle) -> Array:
    """Return some states (16, n) of flight, high and low, thrusts in N."""
    spread = np.random.default_rng(0).uniform(-1.0, 1.0, (STATE_SIZE, 16))
    x = _hover(vehicle, 0.0)[:, None] * (1.0 + 0.5 * spread)
    x[P], x[V] = spread[P] - 1.5 * np.array([[0.0], [0.0], [1.0]]), 3.0 * spread[V]
    x[THETA], x[RATE] = 0.5 * spread[THETA], spread[RATE]
    return x
