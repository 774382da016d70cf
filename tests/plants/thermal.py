"""A foreign plant in plain Python: a point-symmetric quadrotor that crosses a column of rising air.

Nothing of the simulator is used. The rising air lifts the vehicle near one spot of the room, which is in no
library of effects. Options: `strength_m_s2`, `centre_m` [north, east], `radius_m`; for tests of bad plants
`fail_after_ticks` (raises), `nan_after_ticks` and `malformed` (a state without the battery's voltage).
"""

from __future__ import annotations

import math

GRAVITY = 9.81
TICK_S = 0.001


class Thermal:
    """The plant; see `trimtab.sitl.foreign` for what is asked of one."""

    def __init__(self, vehicle, options, seed):
        self.vehicle = vehicle
        self.strength = options.get("strength_m_s2", 0.8)
        self.centre = options.get("centre_m", [1.0, 0.5])
        self.radius = options.get("radius_m", 0.7)
        self.fail_after = options.get("fail_after_ticks", 1 << 60)
        self.nan_after = options.get("nan_after_ticks", 1 << 60)
        self.malformed = options.get("malformed", False)
        self.ticks = 0

    def reset(self, p_ned, q_ned_frd):
        self.p, self.v = list(p_ned), [0.0, 0.0, 0.0]
        self.q, self.rate = list(q_ned_frd), [0.0, 0.0, 0.0]
        self.thrust = [0.0] * 4
        self.force = [0.0, 0.0, -GRAVITY]

    def step(self, motor_command, dt_us):
        for _ in range(dt_us // 1000):
            self._tick(motor_command)

    def state(self):
        parts = [self.p, self.v, self.q, self.rate, self.force]
        return parts if self.malformed else [*parts, self.vehicle.battery.full_v]

    def _tick(self, command):
        self.ticks += 1
        if self.ticks > self.fail_after:
            raise ArithmeticError("the column has collapsed")
        craft, share = self.vehicle, TICK_S / self.vehicle.motor_lag_s
        c1, c2 = craft.thrust_curve
        tau = [0.0, 0.0, 0.0]
        for i, rotor in enumerate(craft.rotors):
            wanted = craft.thrust_max_n * command[i] * (c1 + c2 * command[i])
            self.thrust[i] += share * (wanted - self.thrust[i])
            x, y, _ = rotor.position_m
            tau[0] -= y * self.thrust[i]
            tau[1] += x * self.thrust[i]
            tau[2] += craft.torque_per_thrust_m * self.thrust[i] * (1 if rotor.spin == "ccw" else -1)
        w, x, y, z = self.q
        down = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
        lift = sum(self.thrust) / craft.mass_kg
        away = math.hypot(self.p[0] - self.centre[0], self.p[1] - self.centre[1]) / self.radius
        rising = self.strength * math.exp(-away * away)
        a = [-lift * down[0], -lift * down[1], -lift * down[2] + GRAVITY - rising]
        on_floor = self.p[2] >= 0.0 and a[2] > 0.0
        if on_floor:
            a, tau = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            self.v, self.rate = [0.0] * 3, [0.0] * 3
            self.p[2] = 0.0
        felt = (a[0], a[1], a[2] - GRAVITY)
        self.force = self._into_body(felt)
        p, q, r = self.rate
        jx, jy, jz = craft.inertia_kg_m2
        turning = (
            (tau[0] - (jz - jy) * q * r) / jx,
            (tau[1] - (jx - jz) * r * p) / jy,
            (tau[2] - (jy - jx) * p * q) / jz,
        )
        for k in range(3):
            self.v[k] += TICK_S * a[k]
            self.p[k] += TICK_S * self.v[k]
            self.rate[k] += TICK_S * turning[k]
        p, q, r = (0.5 * TICK_S * rate for rate in self.rate)
        turned = [w - x * p - y * q - z * r, x + w * p + y * r - z * q]
        turned += [y + w * q + z * p - x * r, z + w * r + x * q - y * p]
        length = math.sqrt(sum(c * c for c in turned))
        self.q = [c / length for c in turned]
        if self.ticks > self.nan_after:
            self.v[1] = math.nan

    def _into_body(self, u):
        w, x, y, z = self.q
        return [
            (1 - 2 * (y * y + z * z)) * u[0] + 2 * (x * y + w * z) * u[1] + 2 * (x * z - w * y) * u[2],
            2 * (x * y - w * z) * u[0] + (1 - 2 * (x * x + z * z)) * u[1] + 2 * (y * z + w * x) * u[2],
            2 * (x * z + w * y) * u[0] + 2 * (y * z - w * x) * u[1] + (1 - 2 * (x * x + y * y)) * u[2],
        ]


class Broken:
    """Cannot even be built."""

    def __init__(self, vehicle, options, seed):
        raise RuntimeError("no air in this room")


class Stub:
    """Has no state."""

    def __init__(self, vehicle, options, seed):
        pass

    def reset(self, p_ned, q_ned_frd):
        pass


class Placed(Thermal):
    """Takes a world, and has none of its effects."""

    def __init__(self, vehicle, options, seed, world):
        super().__init__(vehicle, options, seed)
        self.effects = dict(world.effects)
