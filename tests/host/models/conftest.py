"""A smooth reference, and an independent flight of it: the law's own 1 kHz tick around the rigid body."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from trimtab.firmware_model.flight.engine import doubles
from trimtab.firmware_model.law import feedforward as law_feedforward
from trimtab.firmware_model.law import step as law_step
from trimtab.firmware_model.law.allocation import command_to_thrust
from trimtab.firmware_model.law.reference import cubic_coefficients, septic_coefficients
from trimtab.firmware_model.law.rotations import euler_to_matrix, mat_t_vec, quat_from_euler
from trimtab.host.codegen import Block, compile_blocks
from trimtab.host.models import dynamics
from trimtab.host.models.reference import flat_outputs
from trimtab.host.vehicle import Vehicle, load_vehicle, to_parameters
from trimtab.protocol.blobs import Node, Reference, YawNode


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return load_vehicle("research")


@pytest.fixture(scope="session")
def make_reference(vehicle) -> Callable[..., Reference]:
    """A C3 reference of `duration_s` through slow sines under a smooth window, from rest to rest."""

    def make(duration_s: float = 6.0, size: float = 1.0, turning: bool = False) -> Reference:
        h = 1e-3
        fine = np.arange(-0.2, duration_s + 0.2, h)
        s = np.clip(fine / duration_s, 0.0, 1.0)
        window = 4.0**5 * (s * (1.0 - s)) ** 5
        path = np.stack(
            [
                size * 1.3 * window * np.sin(1.9 * fine),
                size * 1.0 * window * np.sin(2.7 * fine + 0.3),
                -1.2 - size * 0.3 * window * np.sin(1.3 * fine),
            ],
            axis=1,
        )
        levels = [path]
        for _ in range(3):
            levels.append(np.gradient(levels[-1], h, axis=0))
        nodes = []
        for t_us in range(0, round(duration_s * 1e6) + 1, 100_000):
            row = np.concatenate([level[round(t_us * 1e-3) + 200] for level in levels])
            if t_us in (0, round(duration_s * 1e6)):
                row[3:] = 0.0
            nodes.append(Node(t_us, tuple(row)))
        yaws = (YawNode(0, 0.2, 0.0), YawNode(round(duration_s * 1e6), 1.4, 0.0)) if turning else ()
        return Reference(vehicle_id=vehicle.id, origin_ned=(0.5, -0.25, 0.0), nodes=tuple(nodes), yaws=yaws)

    return make


@pytest.fixture(scope="session")
def fly_sampled(vehicle) -> Callable[..., np.ndarray]:
    """States (n, 12) every 10 ms of a flight with exact sensors and poses every 10 ms, `age_ticks` late, and
    motor commands `delay_ticks` late.
    """
    engines: dict[Any, Any] = {}

    def tick(parts: tuple) -> Any:
        curve = (vehicle.thrust_max_n, *vehicle.thrust_curve)

        def plant(ops: Any, inputs: Any) -> dict[str, Any]:
            """RK4 over one tick with the motor command held; then what the sensors show."""
            x, command = inputs["x"], [command_to_thrust(u, *curve) for u in inputs["command"]]
            h = 1e-3

            def rate(state: Any) -> list[Any]:
                return dynamics.derivative(ops, vehicle, parts, state, command)

            k1 = rate(x)
            k2 = rate([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)])
            k3 = rate([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)])
            k4 = rate([a + h * b for a, b in zip(x, k3, strict=True)])
            x = [
                a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e)
                for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)
            ]
            a = rate(x)[3:6]
            force = mat_t_vec(euler_to_matrix(ops, x[6:9]), (a[0], a[1], a[2] - 9.81))
            return {"x": x, "force": force, "q": quat_from_euler(ops, *x[6:9])}

        blocks = [Block(name="x", size=16), Block(name="command", size=4)]
        outputs = [Block(name="x", size=16), Block(name="force", size=3), Block(name="q", size=4)]
        return compile_blocks(plant, blocks, outputs, "plant", engine="vm")

    def fly(
        reference: Reference,
        parts: tuple = (),
        *,
        latency_s: float = 0.0,
        age_ticks: int = 12,
        delay_ticks: int = 0,
        feedforward: tuple[float, ...] = law_feedforward.NEUTRAL,
        observer: float = 0.0,
    ) -> np.ndarray:
        key = tuple((effect.name, tuple(theta)) for effect, theta in parts)
        if key not in engines:
            engines[key] = tick(parts)
        if "law" not in engines:
            engines["law"] = compile_blocks(
                law_step.step, law_step.INPUTS, law_step.OUTPUTS, "law_tick", engine="vm"
            )
        plant, law = engines[key], engines["law"]
        given = doubles(law.inputs)
        steps = reference.duration_us // 1000
        flat = flat_outputs(reference, np.zeros(1))[:, 0]
        x = np.zeros(16)
        x[0:3], x[8] = flat[0:3], flat[12]
        x[12:] = vehicle.mass_kg * 9.81 / 4.0
        nodes, yaws = reference.nodes_ned(), reference.yaw_nodes()
        memory = list(
            law_step.initial_memory(x[0:3].tolist(), (np.cos(x[8] / 2), 0.0, 0.0, np.sin(x[8] / 2)))
        )
        memory[law_step.OBSERVER_THRUST.start] = vehicle.mass_kg * 9.81
        law.inputs["memory"][:] = np.array(memory).data
        parameters = law_step.parameter_vector(to_parameters(vehicle) | {"OBS_GAIN": observer})
        law.inputs["parameters"][:] = np.array(parameters).data
        given["observing"][0] = 1.0
        law.inputs["feedforward"][:] = np.array(feedforward).data
        given["armed"][0] = 1.0
        law.inputs["feedback_weights"][:] = np.ones(2).data
        late = round(latency_s * 1000)
        past: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=age_ticks + late + 1)
        plant.inputs["x"][:] = x.data
        hover = np.sqrt(x[12] / vehicle.thrust_max_n)
        sent = deque([np.full(4, hover)] * (delay_ticks + 1), maxlen=delay_ticks + 1)
        plant.inputs["command"][:] = sent[0].data
        samples = [x[:12].copy()]
        at = yaw_at = 0
        for k in range(1, steps + 1):
            plant.run()
            x = np.array(plant.outputs["x"])
            q = np.array(plant.outputs["q"])
            past.append((x[0:3].copy(), q))
            t_us = k * 1000
            while at < len(nodes) - 2 and nodes[at + 1].t_us <= t_us:
                at += 1
            while yaw_at < len(yaws) - 2 and yaws[yaw_at + 1].t_us <= t_us:
                yaw_at += 1
            a, b = nodes[at], nodes[at + 1]
            septic = septic_coefficients((b.t_us - a.t_us) * 1e-6, a.state, b.state)
            law.inputs["piece"][:] = np.array([(t_us - a.t_us) * 1e-6, *septic]).data
            c, d = yaws[yaw_at], yaws[min(yaw_at + 1, len(yaws) - 1)]
            cubic = cubic_coefficients(max(d.t_us - c.t_us, 1) * 1e-6, *c[1:], *d[1:])
            inside_s = (t_us - c.t_us) * 1e-6 * (len(yaws) > 1)
            law.inputs["yaw_piece"][:] = np.array([inside_s, *cubic]).data
            law.inputs["gyro"][:] = x[9:12].copy().data
            law.inputs["specific_force"][:] = plant.outputs["force"]
            given["mocap_new"][0] = float(k % 10 == 0)
            law.inputs["mocap_p"][:] = past[0][0].data
            law.inputs["mocap_q"][:] = past[0][1].data
            given["mocap_age_s"][0] = min(len(past) - 1, age_ticks) * 1e-3
            given["mocap_interval_s"][0] = 0.01
            law.run()
            law.inputs["memory"][:] = law.outputs["memory"]
            sent.append(np.array(law.outputs["motor_command"]))
            plant.inputs["command"][:] = sent[0].data
            plant.inputs["x"][:] = plant.outputs["x"]
            if k % 10 == 0:
                samples.append(x[:12].copy())
        return np.array(samples)

    return fly
