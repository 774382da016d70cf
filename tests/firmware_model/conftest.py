"""A vehicle for the firmware's tests: a rigid body with four lagging rotors and a floor, written for them."""

from __future__ import annotations

import math
from collections import deque

import pytest

from trimtab.firmware_model.flight.flight import Flight
from trimtab.firmware_model.flight.parameters import ParameterValues
from trimtab.firmware_model.flight.supervisor import Event, State
from trimtab.firmware_model.flight.track import track
from trimtab.firmware_model.law import step as law
from trimtab.firmware_model.law.reference import septic
from trimtab.firmware_model.mcu.flight_mcu import FlightMcu, flight_uart
from trimtab.firmware_model.mcu.radio_mcu import RadioMcu
from trimtab.firmware_model.mcu.uart import UartPort, connect
from trimtab.firmware_model.storage.store import ReferenceStore
from trimtab.host.codegen import compile_blocks
from trimtab.protocol import messages as m
from trimtab.protocol.blobs import Node, Reference, YawNode
from trimtab.protocol.codec import Codec
from trimtab.protocol.messages import HOST, HOST_RADIO
from trimtab.protocol.parameters import DEFAULTS
from trimtab.protocol.upload import UploadSender

GRAVITY = 9.81
TICK_US = 1_000
REST9 = (0.0,) * 9


class Body:
    """Rigid body by explicit Euler steps of 1 ms; attitude as a matrix, re-normalised by rows. NED, FRD."""

    def __init__(self, p=(0.0, 0.0, 0.0), yaw=0.0, gain=1.0):
        self.p, self.v, self.w = list(p), [0.0] * 3, [0.0] * 3
        self.floor = self.p[2]  # down: below the start is the floor, or a table
        c, s = math.cos(yaw), math.sin(yaw)
        self.R = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        self.thrust = [0.0] * 4
        self.gain = gain
        self.force = (0.0, 0.0, -GRAVITY)
        self.thrust_max, self.kappa = DEFAULTS["THRUST_MAX"], DEFAULTS["TORQUE_PER_N"]
        self.mass = DEFAULTS["MASS"]
        self.J = [DEFAULTS[f"INERTIA_{axis}"] for axis in "XYZ"]
        self.rotors = [
            tuple(DEFAULTS[f"ROTOR{k}_{what}"] for what in ("X", "Y", "SPIN")) for k in (1, 2, 3, 4)
        ]

    def step(self, command, dt=1e-3):
        per_lag, most = dt / 0.033, self.gain * self.thrust_max
        self.thrust = [t + per_lag * (most * u * u - t) for t, u in zip(self.thrust, command, strict=True)]
        total = tx = ty = tz = 0.0
        for (x, y, spin), t in zip(self.rotors, self.thrust, strict=True):
            total, tx, ty, tz = total + t, tx - y * t, ty + x * t, tz + self.kappa * spin * t
        R, w, J = self.R, self.w, self.J
        a = [-R[i][2] * total / self.mass + (GRAVITY if i == 2 else 0.0) for i in range(3)]
        on_floor = self.p[2] >= self.floor and (a[2] >= 0.0 or self.v[2] > 0.0)
        if on_floor:
            a = [-x / dt for x in self.v]  # the floor's blow is felt
            self.p[2], self.v, self.w = self.floor, [0.0] * 3, [0.0] * 3
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
        x, y, z = a[0], a[1], a[2] - GRAVITY
        (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = R
        self.force = (a0 * x + b0 * y + c0 * z, a1 * x + b1 * y + c1 * z, a2 * x + b2 * y + c2 * z)

    def quaternion(self):
        R = self.R
        w = 0.5 * math.sqrt(max(1e-9, 1.0 + R[0][0] + R[1][1] + R[2][2]))
        return (
            w,
            (R[2][1] - R[1][2]) / (4 * w),
            (R[0][2] - R[2][0]) / (4 * w),
            (R[1][0] - R[0][1]) / (4 * w),
        )


def shaken(force, now_us):
    """A specific force with a little of what no accelerometer is without."""
    return (*force[:2], force[2] + 1e-4 * (now_us // TICK_US % 7 - 3))


def measured(p, now_us):
    """A position with a little of what no camera is without: no two in succession are the same to the bit."""
    return (*p[:2], p[2] + 1e-8 * (now_us // 10_000 % 7 - 3))


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
        self.mocap_age_us = 10_000
        self.frozen = False  # the IMU
        self.battery_v = 16.8
        self.gyro_bias = (0.01, -0.02, 0.005)
        self._air: deque[tuple[int, tuple[float, ...], tuple[float, ...]]] = deque()
        self.texts = []
        self.seen = [State.BOOT]

    def tick(self):
        flight, body, now = self.flight, self.body, self.now_us
        if now % 10_000 == 0:
            self._air.append((now, measured(body.p, now), body.quaternion()))
        if self._air and now - self._air[0][0] >= self.mocap_age_us:
            pose = self._air.popleft()
            if self.mocap:
                flight.pose(*pose, now)
        if self.host and now % 100_000 == 0:
            flight.host_heard(now)
        if not self.frozen:
            gyro = [w + b for w, b in zip(body.w, self.gyro_bias, strict=True)]
            self.sample = gyro, shaken(body.force, now)
        flight.tick(now, *self.sample)
        if now % 10_000 == 0:
            flight.update(now, self.battery_v)
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
        assert self.flight.handle_event(Event.ARM, self.now_us) is None
        assert self.flight.handle_event(Event.START, self.now_us) is None

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
    """The law, compiled where a compiler works. Tests run one after the other: each Flight clears it."""
    return compile_blocks(law.step, law.INPUTS, law.OUTPUTS, "flight")


@pytest.fixture
def make_rig(engine):
    return lambda **keywords: Rig(**{"engine": engine, **keywords})


@pytest.fixture
def make_track():
    return there_and_back


@pytest.fixture
def make_body():
    return Body


VEHICLE_ID = "0123456789ab"


def reference_blob(height=1.0, reach=1.5, seconds=2.0, vehicle_id=VEHICLE_ID, pieces=4):
    """A checked there-and-back reference as a blob: nodes on septics from rest to rest."""
    nodes = []
    us = round(1e6 * seconds)
    for leg, (start, end) in enumerate(((0.0, reach), (reach, 0.0))):
        for k in range(pieces + (leg == 1)):
            p, v, a, j, _ = septic(
                seconds, seconds * k / pieces, (start, 0.0, -height, *REST9), (end, 0.0, -height, *REST9)
            )
            nodes.append((leg * us + us * k // pieces, (*p, *v, *a, *j)))
    return Reference(
        vehicle_id=vehicle_id,
        origin_ned=(0.0, 0.0, 0.0),
        nodes=tuple(Node(t, state) for t, state in nodes),
        yaws=(YawNode(0, 0.2, 0.0),),
    )


class Session:
    """Host, two radios, air and vehicle, joined by bytes; the host's codec is all it knows of the vehicle.

    The air: a slot of 2 ms for each side in turn, 4 ms on the way, lost where `lost(now_us)` says so.
    """

    def __init__(self, engine, *, store=None, body=None, parameters=None, uid=7, board_version=0):
        self.engine, self.body = engine, body or Body()
        self.store = store or ReferenceStore()
        self.flight = FlightMcu(
            engine=engine,
            parameters={**DEFAULTS, **(parameters or {})},
            store=self.store,
            uid=uid,
            vehicle_id=bytes.fromhex(VEHICLE_ID),
            board_version=board_version,
        )
        self.radio, self.ground = RadioMcu(), RadioMcu(address=HOST_RADIO)
        self.port = UartPort(baud=921_600, rx_bytes=1 << 16, tx_bytes=1 << 16)
        connect(self.flight.uart, self.radio.uart)
        connect(self.port, self.ground.uart)
        self.host = Codec(*HOST)
        self.now_us = 0
        self.mocap = self.talk = self.radio_ticks = True
        self.every_us, self.battery_v = TICK_US, 16.8
        self.lost = lambda now_us: False
        self.upload: UploadSender | None = None
        self.sender: UploadSender | None = None
        self.inbox = []
        self.commands = []
        self._air = deque()
        self.seen = []

    def send(self, *messages):
        for message in messages:
            assert self.port.write(self.host.encode(message), self.now_us)

    def command(self, number, *parameters):
        self.send(m.CommandLong(1, 1, number, 0, *(*parameters, *(0.0,) * 7)[:7]))

    def tick(self):  # noqa: C901 - the wiring of one tick, in its order
        now, body = self.now_us, self.body
        if self.mocap and now % 10_000 == 0:
            self.send(m.AttPosMocap(now, list(body.quaternion()), *body.p))
        if self.talk and now % 200_000 == 0:
            self.send(m.Timesync(0, 1000 * now))
        if self.upload is not None:
            self.send(*self.upload.send(now))
        self.ground.tick(now)
        if now % 2_000 == 0:
            source, target = (self.ground, self.radio) if now % 4_000 == 0 else (self.radio, self.ground)
            frame = source.air_send(now)
            if frame is not None and not self.lost(now):
                self._air.append((now + 4_000, target, frame))
        while self._air and self._air[0][0] <= now:
            _, target, frame = self._air.popleft()
            target.air_receive(frame, now)
        if self.radio_ticks:
            self.radio.tick(now)
        if now % self.every_us == 0:
            self.flight.tick(now, body.w, shaken(body.force, now), self.battery_v)
        self.commands.append(tuple(self.flight.motor_command))
        if not self.seen or self.seen[-1] is not self.flight.state:
            self.seen.append(self.flight.state)
        body.step(self.flight.motor_command)
        if now >= self.port.due_us:
            messages = self.host.decode(self.port.read(now))
            self.inbox += messages
            if self.upload is not None:
                for message in messages:
                    self.upload.receive(message, now)
                self.upload.advance(now)
        self.now_us += TICK_US

    def run(self, seconds, until=None):
        end = self.now_us + round(1e6 * seconds)
        while self.now_us < end:
            self.tick()
            if until is not None and until():
                return
        assert until is None, f"never came; {self.seen}; {self.texts()}"

    def run_to(self, state, seconds=20.0):
        self.run(seconds, until=lambda: self.flight.state is state)

    def put(self, blob, seconds=20.0):
        self.upload = upload = UploadSender(blob.to_bytes(), blob.KIND)
        self.run(seconds, until=lambda: upload.state.name in ("DONE", "FAILED"))
        self.upload = None
        return upload

    def received(self, kind):
        return [message for message in self.inbox if isinstance(message, kind)]

    def texts(self):
        return [message.text for message in self.received(m.StatusText)]

    def take_off(self):
        self.run(1.0)
        self.command(400, 1.0)
        self.run_to(State.ARMED, 1.0)
        self.command(300)
        self.run_to(State.TAKEOFF, 1.0)


@pytest.fixture
def make_session(engine):
    return lambda **keywords: Session(engine, **keywords)


@pytest.fixture
def make_blob():
    return reference_blob


@pytest.fixture(scope="session")
def flown(engine):
    """One whole session for several tests: upload, arm, start, fly, land. `sender` is its upload."""
    session = Session(engine)
    session.run(0.5)
    session.sender = session.put(reference_blob())
    session.take_off()
    session.run_to(State.STANDBY)
    session.run(0.3)
    return session


class Line:
    """A FlightMcu on a bare serial line, no radios: what stations of any address say and hear on it."""

    def __init__(self, engine, *, store=None, parameters=None, wired=False):
        self.body = Body()
        self.store = store or ReferenceStore()
        self.flight = FlightMcu(
            engine=engine,
            parameters={**DEFAULTS, **(parameters or {})},
            store=self.store,
            uid=7,
            vehicle_id=bytes.fromhex(VEHICLE_ID),
            uart=flight_uart(wired=wired),
        )
        self.port = UartPort(baud=921_600, rx_bytes=1 << 16, tx_bytes=1 << 16)
        connect(self.port, self.flight.uart)
        self.codecs = {}
        self.ears = Codec(*HOST)
        self.now_us = 0
        self.inbox = []
        self.bytes_heard = 0

    def send(self, *messages, source=HOST):
        codec = self.codecs.setdefault(source, Codec(*source))
        for message in messages:
            assert self.port.write(codec.encode(message), self.now_us)

    def command(self, number, *parameters, source=HOST):
        self.send(m.CommandLong(1, 1, number, 0, *(*parameters, *(0.0,) * 7)[:7]), source=source)

    def run(self, seconds, until=None):
        end = self.now_us + round(1e6 * seconds)
        while self.now_us < end:
            self.flight.tick(self.now_us, self.body.w, self.body.force, 16.8)
            self.now_us += TICK_US
            data = self.port.read(self.now_us)
            self.bytes_heard += len(data)
            self.inbox += self.ears.decode(data)
            if until is not None and until():
                return
        assert until is None, f"never came; {self.texts()}"

    def received(self, kind):
        return [message for message in self.inbox if isinstance(message, kind)]

    def texts(self):
        return [message.text for message in self.received(m.StatusText)]


@pytest.fixture
def make_line(engine):
    return lambda **keywords: Line(engine, **keywords)
