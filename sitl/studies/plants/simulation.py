"""What the plants of this package share: effects around a library's equations of motion, and time steps.

A library gives the derivative of the rigid body and its rotors, with its own thrust, drag and motor dynamics.
Added here is what these libraries lack: floor, turbulence, battery, delay of commands, a constant torque,
ground effect and a slung payload. A rotor speed is a share of full speed, at which the thrust is
`thrust_max_n`. Frames: world NED, body FRD; p and v of the state belong to the centre of mass.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from trimtab.host.codegen import CompiledEngine, sx_function
from trimtab.host.vehicle import Vehicle
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.carried import START_DEPTH, battery, payload_at_rest
from trimtab.sitl.draw import World, draw_world
from trimtab.sitl.gusts import Gusts
from trimtab.sitl.plant_constants import SINK_M, plant_parameters
from trimtab.sitl.plant_model import TICK_S, Block, cut, next_gust, origin
from trimtab.sitl.rotors import ground_gain
from trimtab.sitl.studies.plants import PLANTS
from trimtab.sitl.surroundings import GRAVITY_M_S2, floor, payload
from trimtab.sitl.vectors import Scalar, Vector, add, ahead, cross, dot, into_body, into_world, rotation, unit
from trimtab.sitl.world import load_world

FULL_SPEED_RAD_S = 1500.0
"""Rotor speed at full thrust. Flights do not depend on it: a vehicle file holds thrusts, not speeds."""

BODY = (Block("p_ned", 3), Block("v_ned", 3), Block("q_ned_frd", 4), Block("rate_frd", 3), Block("speeds", 4))
"""State of the rigid body and its rotors."""

_STATE = (*BODY, Block("charge_used_c", 1), Block("gust", 6), Block("payload_ned", 6))
_INPUTS = (Block("state", sum(size for _, size in _STATE)), Block("command", 4), Block("noise", 6))
_OUTPUTS = (_INPUTS[0], Block("pose", 10), Block("sensed", 7))
_NOISE_BLOCK = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class Craft:
    """A vehicle in a world, as parameters of the libraries need it."""

    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]
    arms_frd: np.ndarray
    """Hubs of the rotors from the centre of mass, m, (4, 3)."""
    spins: tuple[float, ...]
    """1 for counter-clockwise from above, else -1."""
    thrust_max_n: float
    """Of a rotor without loss, with the gain of thrust."""
    rotor_loss: tuple[float, ...]
    """Lost share of thrust and torque of each rotor."""
    torque_per_thrust_m: float
    rise_s: float
    """Time constant of a rotor that speeds up."""
    fall_s: float
    """Time constant of a rotor that slows down."""
    hover_rad_s: float
    """Rotor speed at hover of the vehicle in its file."""
    linear_drag: tuple[float, float, float]
    """N per m/s along each body axis, at hover."""
    quadratic_drag: float
    """N per (m/s)^2."""
    translational_lift: float
    """N per (m/s)^2 of the speed across the rotors, of the vehicle."""
    thrust_inflow: float
    """N per m/s along the axis, of the vehicle at hover."""
    rotor_inertia_kg_m2: float
    """Of one rotor about its axis."""
    flapping: float
    """N m per m/s across the rotors, of the vehicle at hover; positive lifts the side that meets the air."""


class Equations(Protocol):
    """The equations of motion of a library for one craft, on scalars of CasADi."""

    def derivative(
        self,
        body: Mapping[str, Vector],
        target: Vector,
        wind_ned: Vector,
        force_ned: Vector,
        torque_frd: Vector,
    ) -> Sequence[Scalar]:
        """Return the derivative of the body in the order of `BODY`.

        target: commanded rotor speeds, share of full speed. force_ned, torque_frd: from outside, N and N m,
        at the centre of mass.
        """
        ...


class SteppedPlant:
    """A foreign plant, as `trimtab.sitl.foreign` defines it, around the equations of a library.

    Parameters
    ----------
    name
        Name in `PLANTS`.
    equations
        Makes the library's equations of a craft.
    options
        Must be empty.
    seed
        Seed of turbulence and battery in this flight.
    world
        The world whose effects, deviations and turbulence act. Default: none of them.

    Raises ValueError for options, and for effects that the plant cannot have.
    """

    def __init__(
        self,
        name: str,
        equations: Callable[[Craft], Equations],
        vehicle: Vehicle,
        options: Mapping[str, Any],
        seed: int,
        world: World | None,
    ) -> None:
        if options:
            raise ValueError(f"it takes no options; leave out {', '.join(options)}")
        if world is None:
            world = draw_world("quiet", load_world("quiet")[1], 0, vehicle)
        known = PLANTS[name].effects
        if lacking := [kind for kind in world.effects if kind not in known]:
            raise ValueError(f"it cannot have {', '.join(lacking)}; choose from {', '.join(sorted(known))}")
        P, com = plant_parameters(vehicle, world), _com(world)
        discharges = {"battery-sag"} if world.battery.discharges else set[str]()
        parts = frozenset({*world.effects, *discharges})
        tick = _Tick(equations(craft(vehicle, world)), P, com, vehicle, parts)
        self._engine = CompiledEngine(sx_function(tick, _INPUTS, _OUTPUTS, "plant"), _INPUTS, _OUTPUTS, "vm")
        self._com, self._line_m, self._full_v = com, P["payload"][1], P["battery"][0]
        rng = np.random.default_rng(seed)
        depth = rng.uniform(0.0, START_DEPTH) if "battery-sag" in parts else 0.0
        self._charge_used_c = depth * P["battery"][3]
        self._gusts = Gusts(world.turbulence, rng)
        delay = world.value("actuation-delay", "delay_s") / TICK_S
        self._late, self._part = int(delay), delay % 1.0

    def reset(self, p_ned: Sequence[float], q_ned_frd: Sequence[float]) -> None:
        """Put the vehicle at rest at a pose, with rotors stopped. At z_ned = 0 it stands on the floor."""
        place = into_world(rotation(q_ned_frd), self._com)
        p = [a + b for a, b in zip(p_ned, place, strict=True)]
        if p_ned[2] == 0.0:
            p[2] += SINK_M
        gusts = self._gusts.start()
        hanging = [*payload_at_rest(p_ned, self._line_m), 0.0, 0.0, 0.0]
        body = [*p, 0.0, 0.0, 0.0, *q_ned_frd, *[0.0] * 7]
        out = self._engine.outputs
        out["state"][:] = _doubles([*body, self._charge_used_c, *gusts, *hanging])
        out["pose"][:] = _doubles([*p_ned, 0.0, 0.0, 0.0, *q_ned_frd])
        out["sensed"][:] = _doubles([0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY_M_S2, self._full_v])
        self._sent = deque([(0.0,) * 4] * (self._late + 2), maxlen=self._late + 2)
        self._noise: list[Any] = []

    def step(self, motor_command: Sequence[float], dt_us: int) -> None:
        """Advance by whole milliseconds with constant motor commands in 0..1."""
        inputs, outputs, part = self._engine.inputs, self._engine.outputs, self._part
        for _ in range(dt_us // TICK_US):
            self._sent.append(tuple(motor_command))
            later, earlier = self._sent[1], self._sent[0]
            inputs["command"][:] = _doubles([a + part * (b - a) for a, b in zip(later, earlier, strict=True)])
            if not self._noise:
                self._noise = [row.data for row in self._gusts.noise(_NOISE_BLOCK)[::-1].copy()]
            inputs["noise"][:] = self._noise.pop()
            inputs["state"][:] = outputs["state"]
            self._engine.run()

    def state(self) -> tuple[Any, ...]:
        """Return p_ned, v_ned, q_ned_frd, rate_frd, specific_force_frd and battery_v."""
        pose, sensed = self._engine.outputs["pose"], self._engine.outputs["sensed"]
        return pose[0:3], pose[3:6], pose[6:10], sensed[0:3], sensed[3:6], sensed[6]


def flipped(vector: Sequence[Scalar]) -> list[Scalar]:
    """Return a vector of FRD in forward-left-up, or of NED in north-west-up, or back."""
    x, y, z = vector
    return [x, -y, -z]


def craft(vehicle: Vehicle, world: World) -> Craft:
    """Return the vehicle with what the world changes in it."""
    value, mass = world.value, vehicle.mass_kg
    hover = math.sqrt(mass * GRAVITY_M_S2 / (4.0 * vehicle.thrust_max_n)) * FULL_SPEED_RAD_S
    x, y, z = (j * value("inertia", axis) for j, axis in zip(vehicle.inertia_kg_m2, "xyz", strict=True))
    momentum = value("gyroscopic", "h") * vehicle.inertia_kg_m2[0]
    dx, dy, dz = (mass * value("linear-drag", key) for key in ("dx", "dy", "dz"))
    lag = vehicle.motor_lag_s + value("motor-lag", "extra_s")
    ratio = value("uneven-lag", "ratio")
    return Craft(
        mass_kg=mass * value("mass", "factor"),
        inertia_kg_m2=(x, y, z),
        arms_frd=np.array([rotor.position_m for rotor in vehicle.rotors]) - _com(world),
        spins=tuple(1.0 if rotor.spin == "ccw" else -1.0 for rotor in vehicle.rotors),
        thrust_max_n=vehicle.thrust_max_n * value("thrust-gain", "gain"),
        rotor_loss=tuple(value("rotor-loss", f"loss_{i}") for i in (1, 2, 3, 4)),
        torque_per_thrust_m=vehicle.torque_per_thrust_m,
        rise_s=2.0 * lag / (1.0 + ratio),
        fall_s=2.0 * lag * ratio / (1.0 + ratio),
        hover_rad_s=hover,
        linear_drag=(dx, dy, dz),
        quadratic_drag=mass * value("quadratic-drag", "c"),
        translational_lift=mass * value("translational-lift", "k"),
        thrust_inflow=mass * value("thrust-inflow", "k"),
        rotor_inertia_kg_m2=momentum / hover,
        flapping=value("blade-flapping", "moment") * vehicle.inertia_kg_m2[0],
    )


class _Tick:
    """One millisecond of a plant as a function of the blocks `_INPUTS`, with the constants of one world."""

    def __init__(
        self,
        equations: Equations,
        P: Mapping[str, Sequence[float]],
        com_frd: Sequence[float],
        vehicle: Vehicle,
        parts: frozenset[str],
    ) -> None:
        self._equations, self._P, self._com, self._parts = equations, P, com_frd, parts
        self._mass, self._inertia = vehicle.mass_kg, vehicle.inertia_kg_m2
        self._arms = [[a - c for a, c in zip(r.position_m, com_frd, strict=True)] for r in vehicle.rotors]

    def __call__(self, ops: Any, inputs: Mapping[str, Vector]) -> dict[str, list[Scalar]]:
        P, x = self._P, cut(_STATE, inputs["state"])
        voltage, charge = P["battery"][0], x["charge_used_c"][0]
        if "battery-sag" in self._parts:
            voltage, charge = battery(ops, P, x["speeds"], charge, TICK_S)
        gusts = next_gust(P, x["gust"], inputs["noise"])
        line, hanging = [0.0, 0.0, 0.0], x["payload_ned"]
        if "slung-payload" in self._parts:
            line, hanging = self._hang(ops, x)
        target = self._target(ops, inputs["command"], voltage)

        def slope(y: Vector) -> list[Scalar]:
            body = cut(BODY, y)
            force, torque = self._outside(ops, body, gusts, line)
            return list(self._equations.derivative(body, target, [*P["wind_ned"], 0.0], force, torque))

        y = [c for block in BODY for c in x[block.name]]
        y = _runge_kutta(slope, y)
        end = cut(BODY, y)
        q, w = unit(ops, end["q_ned_frd"]), end["rate_frd"]
        state = [*end["p_ned"], *end["v_ned"], *q, *w, *end["speeds"], charge, *gusts, *hanging]
        pose = [*origin(end["p_ned"], end["v_ned"], rotation(q), w, self._com), *q]
        return {"state": state, "pose": pose, "sensed": [*w, *self._felt(ops, x, end), voltage]}

    def _target(self, ops: Any, command: Vector, voltage: Scalar) -> list[Scalar]:
        """Return the commanded rotor speeds, which fall with voltage; in a dead zone they are constant."""
        c1, c2 = self._P["thrust_curve"]
        if "dead-zone" in self._parts:
            centre, width = self._P["dead_zone"]
            command = [ops.where(ops.fabs(u - centre) < width, centre, u) for u in command]
        speeds = [ops.sqrt(u * (c1 + c2 * u)) for u in command]
        if "battery-sag" not in self._parts:
            return speeds
        sag = ops.exp(0.5 * self._P["sag_exponent"][0] * ops.log(voltage / self._P["battery"][0]))
        return [n * sag for n in speeds]

    def _outside(
        self, ops: Any, body: Mapping[str, Vector], gusts: Vector, line: Vector
    ) -> tuple[list[Scalar], list[Scalar]]:
        """Return force in NED and torque in FRD of what the libraries lack."""
        P, p, w, speeds = self._P, body["p_ned"], body["rate_frd"], body["speeds"]
        R = rotation(body["q_ned_frd"])
        force, torque = floor(ops, P, p, body["v_ned"], R, w, self._arms)
        force = [f + self._mass * g + t for f, g, t in zip(force, gusts[:3], line, strict=True)]
        pulled = cross([-c for c in self._com], into_body(R, line))
        torque = add(add(torque, pulled), P["torque_bias"])
        torque = [t + j * g for t, j, g in zip(torque, self._inertia, gusts[3:], strict=True)]
        if "ground-effect" in self._parts:
            for i, arm in enumerate(self._arms):
                more = ground_gain(ops, P, -p[2] - dot(R[6:9], arm), R[8]) - 1
                lift = [0.0, 0.0, -more * P["thrust_max_n"][0] * speeds[i] * speeds[i]]
                force, torque = add(force, into_world(R, lift)), add(torque, cross(arm, lift))
        return force, torque

    def _hang(self, ops: Any, x: Mapping[str, Vector]) -> tuple[list[Scalar], list[Scalar]]:
        """Return the force in NED of a payload's line at the origin, and the payload's next state."""
        R = rotation(x["q_ned_frd"])
        hook = origin(x["p_ned"], x["v_ned"], R, x["rate_frd"], self._com)
        p, v = x["payload_ned"][:3], x["payload_ned"][3:]
        a, line = payload(ops, self._P, hook[:3], hook[3:], p, v, self._P["wind_ned"])
        v = ahead(v, a, TICK_S)
        return line, [*ahead(p, v, TICK_S), *v]

    def _felt(self, ops: Any, start: Mapping[str, Vector], end: Mapping[str, Vector]) -> list[Scalar]:
        """Return the mean specific force at the origin over the tick, FRD at its middle."""
        w, h = end["rate_frd"], TICK_S
        R = rotation(unit(ops, add(start["q_ned_frd"], end["q_ned_frd"])))
        a = [(after - before) / h for after, before in zip(end["v_ned"], start["v_ned"], strict=True)]
        turning = [(after - before) / h for after, before in zip(w, start["rate_frd"], strict=True)]
        carried = add(cross(turning, self._com), cross(w, cross(w, self._com)))
        force = into_body(R, [a[0], a[1], a[2] - GRAVITY_M_S2])
        return [f - c for f, c in zip(force, carried, strict=True)]


def _runge_kutta(slope: Callable[[Vector], list[Scalar]], y: Vector) -> list[Scalar]:
    """Return the state after a tick by the classic method of fourth order."""
    h = TICK_S
    k1 = slope(y)
    k2 = slope(ahead(y, k1, 0.5 * h))
    k3 = slope(ahead(y, k2, 0.5 * h))
    k4 = slope(ahead(y, k3, h))
    slopes = zip(k1, k2, k3, k4, strict=True)
    return ahead(y, [(a + 2 * b + 2 * c + d) / 6 for a, b, c, d in slopes], h)


def _com(world: World) -> tuple[float, float, float]:
    """Return the centre of mass, FRD, m."""
    return world.value("com-offset", "x"), world.value("com-offset", "y"), 0.0


def _doubles(values: Sequence[float]) -> memoryview:
    return memoryview(array("d", values))
