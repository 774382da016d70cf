"""A vehicle for the firmware's tests: a rigid body with four lagging rotors and a floor, written for them."""

from __future__ import annotations

import math
from collections import deque

import pytest

from firmware_model.flight import Flight
from firmware_model.law import step as law
from firmware_model.parameters import ParameterValues
from firmware_model.supervisor import Event, State
from firmware_model.track import track
from host.codegen import compile_blocks
from protocol.parameters import DEFAULTS

GRAVITY = 9.81
TICK_US = 1_000
REST9 = (0.0,) * 9


class Body:
    """Rigid body by explicit Euler steps of 1 ms; attitude as a matrix, re-normalised by rows. NED, FRD."""

    def __init__(self, p=(0.0, 0.0, 0.0), yaw=0.0, gain=1.0):
        self.p, self.v, self.w = list(p), [0.0] * 3, [0.0] * 3
        c, s = math.cos(yaw), math.sin(yaw)
        self.R = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        self.thrust = [0.0] * 4
        self.gain = gain
        self.force = (0.0, 0.0, -GRAVITY)
        self.mass = DEFAULTS["MASS"]
        self.J = [DEFAULTS[f"INERTIA_{axis}"] for axis in "XYZ"]
        self.rotors = [
            tuple(DEFAULTS[f"ROTOR{k}_{what}"] for what in ("X", "Y", "SPIN")) for k in (1, 2, 3, 4)
        ]

    def step(self, command, dt=1e-3):
        thrust_max, lag = DEFAULTS["THRUST_MAX"], 0.033
        for k in range(4):
            self.thrust[k] += dt / lag * (self.gain * thrust_max * command[k] ** 2 - self.thrust[k])
        total = sum(self.thrust)
        tx = sum(-y * t for (_, y, _), t in zip(self.rotors, self.thrust, strict=True))
        ty = sum(x * t for (x, _, _), t in zip(self.rotors, self.thrust, strict=True))
        tz = sum(
            DEFAULTS["TORQUE_PER_N"] * s * t for (_, _, s), t in zip(self.rotors, self.thrust, strict=True)
        )
        R, w, J = self.R, self.w, self.J
        a = [-R[i][2] * total / self.mass + (GRAVITY if i == 2 else 0.0) for i in range(3)]
        on_floor = self.p[2] >= 0.0 and a[2] >= 0.0
        if on_floor:
            a = [-x / dt for x in self.v]  # the floor's blow is felt
            self.p[2], self.v, self.w = 0.0, [0.0] * 3, [0.0] * 3
        else:
            for i in range(3):
                self.p[i] += dt * (self.v[i] + 0.5 * dt * a[i])
                self.v[i] += dt * a[i]
            alpha = [
                (tx - (J[2] - J[1]) * w[1] * w[2]) / J[0],
                (ty - (J[0] - J[2]) * w[2] * w[0]) / J[1],
                (tz - (J[1] - J[0]) * w[0] * w[1]) / J[2],
            ]
            self.w = w = [x + dt * y for x, y in zip(w, alpha, strict=True)]
            for i in range(3):
                x, y, z = R[i]
                row = [
                    x + dt * (y * w[2] - z * w[1]),
                    y + dt * (z * w[0] - x * w[2]),
                    z + dt * (x * w[1] - y * w[0]),
                ]
                length = math.hypot(*row)
                R[i] = [value / length for value in row]
        b = [a[0], a[1], a[2] - GRAVITY]
        self.force = tuple(sum(R[i][k] * b[i] for i in range(3)) for k in range(3))

    def quaternion(self):
        R = self.R
        w = 0.5 * math.sqrt(max(1e-9, 1.0 + R[0][0] + R[1][1] + R[2][2]))
        return (
            w,
            (R[2][1] - R[1][2]) / (4 * w),
            (R[0][2] - R[2][0]) / (4 * w),
            (R[1][0] - R[0][1]) / (4 * w),
        )


class Rig:
    """A Flight and a Body: poses at 100 Hz, 10 ms old, a word from the host every 100 ms. Both can be cut."""

    def __init__(self, engine, *, body=None, parameters=None, reference=True):
        self.body = body or Body()
        self.flight = Flight(engine=engine, parameters=ParameterValues({**DEFAULTS, **(parameters or {})}))
        if reference:
            self.flight.reference = there_and_back()
        self.command = engine.outputs["motor_command"]
        self.now_us = 0
        self.mocap = self.host = True
        self.gyro_bias = (0.01, -0.02, 0.005)
        self._air = deque()
        self.texts = []
        self.seen = [State.BOOT]

    def tick(self):
        flight, body, now = self.flight, self.body, self.now_us
        if now % 10_000 == 0:
            self._air.append((now, tuple(body.p), body.quaternion()))
        if self._air and now - self._air[0][0] >= 10_000:
            pose = self._air.popleft()
            if self.mocap:
                flight.pose(*pose, now)
        if self.host and now % 100_000 == 0:
            flight.host_heard(now)
        flight.tick(now, [w + b for w, b in zip(body.w, self.gyro_bias, strict=True)], body.force)
        if now % 10_000 == 0:
            flight.look(now)
        while flight.texts:
            self.texts.append(flight.texts.popleft()[1])
        if self.seen[-1] is not flight.state:
            self.seen.append(flight.state)
        body.step(self.command)
        self.now_us += TICK_US

    def run(self, seconds, until=None):
        end = self.now_us + round(1e6 * seconds)
        while self.now_us < end:
            self.tick()
            if until is not None and self.flight.state is until:
                return
        assert until is None, f"{until.name} was not reached; {self.seen}; {self.texts}"

    def standby(self):
        self.run(1.0)
        assert self.flight.state is State.STANDBY

    def take_off(self):
        self.standby()
        assert self.flight.command(Event.ARM, self.now_us) is None
        assert self.flight.command(Event.START, self.now_us) is None

    def track(self):
        self.take_off()
        self.run(10.0, until=State.TRACKING)

    def estimate(self):
        return tuple(self.flight._memory[0:3])


def there_and_back(height=1.0, reach=1.5, seconds=2.0):
    """A reference from (0, 0) to (reach, 0) and back at a height, at rest at its three nodes."""
    us = round(1e6 * seconds)
    a, b = (0.0, 0.0, -height, *REST9), (reach, 0.0, -height, *REST9)
    return track([(0, a), (us, b), (2 * us, a)], [(0, 0.2, 0.0)])


@pytest.fixture(scope="session")
def engine():
    """The law in CasADi's virtual machine. Tests run one after the other: each Flight clears it."""
    return compile_blocks(law.step, law.INPUTS, law.OUTPUTS, "flight", engine="vm")


@pytest.fixture
def make_rig(engine):
    return lambda **keywords: Rig(engine, **keywords)


@pytest.fixture
def make_body():
    return Body
