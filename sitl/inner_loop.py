"""The fastest loop of a session: plant, sensors and control law, tick by tick, between two tasks of the firmware.

In most ticks the flight processor only runs its control law. Such ticks are run together, just before
something else needs their result. A loop in C serves the compiled plant and law; a loop in Python does the same
for CasADi's virtual machine and for foreign plants. Both give the same bits.
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable, Sequence
from typing import Any

from trimtab.firmware_model.mcu.flight_mcu import FlightMcu
from trimtab.host.codegen import CompiledEngine, address, c_function, c_library
from trimtab.protocol.telemetry import TICK_US
from trimtab.sitl.foreign import ForeignPlant
from trimtab.sitl.plant import Plant
from trimtab.sitl.sensors import Imu

_SOURCE = """
#include <string.h>
typedef int (*function)(const double **, double **, long long *, double *, int);
typedef struct { function call; const double **arg; double **res; long long *iw; double *w; } engine;
typedef struct {
    engine plant, law;
    double *state, *state_out, *memory, *memory_out;
    long long state_bytes, memory_bytes;
    double *motors, *command, *sent;
    long long sent_bytes;
    const long long *later, *earlier;
    double *part, *sensed, *samples, *noise, *gyro, *force, *piece_s, *yaw_s, *saturated;
} loop;

static void run(const engine *e) { e->call(e->arg, e->res, e->iw, e->w, 0); }

/* Runs `count` ticks after `now_us`, whose law is run first if it is pending. Returns the saturated ticks.
   noise: 6 numbers a tick, or null. errors: 7 numbers a tick. */
long long ticks(loop *s, long long count, long long pending, long long now_us, long long piece_us,
                long long yaw_us, const double *noise, const double *errors)
{
    long long saturated = 0;
    for (long long tick = 0; tick < count; ++tick, now_us += 1000, pending = 1) {
        if (pending) {
            memcpy(s->gyro, s->samples, 3 * sizeof(double));
            memcpy(s->force, s->samples + 3, 3 * sizeof(double));
            s->piece_s[0] = (double)(now_us - piece_us) * 1e-6;
            s->yaw_s[0] = (double)(now_us - yaw_us) * 1e-6;
            run(&s->law);
            memcpy(s->memory, s->memory_out, s->memory_bytes);
            saturated += s->saturated[0] != 0.0;
        }
        if (s->sent_bytes) {
            memmove(s->sent + 4, s->sent, s->sent_bytes - 4 * sizeof(double));
            memcpy(s->sent, s->motors, 4 * sizeof(double));
            for (int i = 0; i < 4; ++i) {
                double newer = s->sent[s->later[i]];
                s->command[i] = newer + s->part[i] * (s->sent[s->earlier[i]] - newer);
            }
        } else memcpy(s->command, s->motors, 4 * sizeof(double));
        if (noise) memcpy(s->noise, noise + 6 * tick, 6 * sizeof(double));
        memcpy(s->state, s->state_out, s->state_bytes);
        run(&s->plant);
        for (int i = 0; i < 7; ++i) s->samples[i] = s->sensed[i] + errors[7 * tick + i];
    }
    return saturated;
}
"""


class InnerLoop:
    """Plant, IMU and control law of one power-up.

    `samples` holds what the IMU measured in the last tick, and the battery voltage. `pending` is whether the
    law is still to be run on them; the owner clears it if the flight processor runs its own tick or misses
    it. `law`: the law of the flight processor's engine as a casadi.Function.
    """

    def __init__(self, plant: Plant | ForeignPlant, imu: Imu, mcu: FlightMcu, law: Any) -> None:
        self.pending = False
        self._now_us = 0
        self._plant, self._imu, self._mcu = plant, imu, mcu
        self._law, self._player = mcu.flight.engine, mcu.flight.player
        inputs: Any = self._law.inputs
        outputs: Any = self._law.outputs
        self._gyro, self._force = inputs["gyro"], inputs["specific_force"]
        self._memory, self._memory_out = inputs["memory"], outputs["memory"]
        self._saturated, self._motors = outputs["saturated"], outputs["motor_command"]
        self._sensed: Any = plant.sensed
        self.samples: Sequence[float] = imu.sample(self._sensed)
        self._native = None
        if isinstance(plant, Plant) and isinstance(self._law, CompiledEngine):
            view = memoryview(array("d", self.samples))
            self._native = native_loop(plant, self._law, law, view)
            self.samples = view if self._native is not None else self.samples

    def advance(self, now_us: int) -> None:
        """Run plant and sensors up to `now_us`, and the law, where it is pending, up to the tick before."""
        count = (now_us - self._now_us) // TICK_US
        if not count:
            return
        laws = count if self.pending else count - 1
        run = self._run if self._native is None else self._run_native
        saturated = run(count)
        self.pending = True
        if laws:
            self._mcu.count_law_ticks(now_us - TICK_US, laws, saturated)

    def _run_native(self, count: int) -> int:
        """Run `count` ticks in C; return the number of saturated ticks."""
        native, plant, imu, player = self._native, self._plant, self._imu, self._player
        assert native is not None and isinstance(plant, Plant)
        saturated = 0
        while count:
            size = min(count, plant.noise_left(), imu.left())
            saturated += native(
                size,
                self.pending,
                self._now_us,
                player.piece_us,
                player.yaw_us,
                plant.take_noise(size),
                imu.take(size),
            )
            self._now_us += size * TICK_US
            self.pending = True
            count -= size
        return saturated

    def _run(self, count: int) -> int:
        """Run `count` ticks in Python; return the number of saturated ticks."""
        player, law, step, sample = self._player, self._law, self._plant.step, self._imu.sample
        piece, yaw, piece_us, yaw_us = player.piece, player.yaw, player.piece_us, player.yaw_us
        gyro, force, memory, memory_out = self._gyro, self._force, self._memory, self._memory_out
        motors, sensed, samples, pending = self._motors, self._sensed, self.samples, self.pending
        begin_us, saturated = self._now_us, 0
        self._now_us += count * TICK_US
        for t_us in range(begin_us, self._now_us, TICK_US):
            if pending:
                gyro[0], gyro[1], gyro[2], force[0], force[1], force[2], _ = samples
                piece[0] = (t_us - piece_us) * 1e-6
                yaw[0] = (t_us - yaw_us) * 1e-6
                law()
                memory[:] = memory_out
                saturated += self._saturated[0] != 0.0
            step(motors)
            samples = sample(sensed)
            pending = True
        self.samples = samples
        return saturated


class _Engine(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("call", "arg", "res", "iw", "w")]


class _Loop(ctypes.Structure):
    """The C struct `loop`; every field not named here is a pointer."""

    _fields_ = [
        ("plant", _Engine),
        ("law", _Engine),
        *((name, ctypes.c_void_p) for name in ("state", "state_out", "memory", "memory_out")),
        ("state_bytes", ctypes.c_longlong),
        ("memory_bytes", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("motors", "command", "sent")),
        ("sent_bytes", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("later", "earlier", "part", "sensed", "samples", "noise")),
        *((name, ctypes.c_void_p) for name in ("gyro", "force", "piece_s", "yaw_s", "saturated")),
    ]


def native_loop(
    plant: Plant, law: CompiledEngine, law_function: Any, samples: memoryview
) -> Callable[..., int] | None:
    """Return the loop in C as a function of the arguments that vary; None unless both engines are compiled."""
    if not plant.engine.kind == law.kind == "c":
        return None
    library, calls = c_library(_SOURCE), [c_function(plant.function), c_function(law_function)]
    if library is None or None in calls:
        return None
    loop, kept = _Loop(), [library, calls, plant, law, samples]
    for field, engine, call in zip(("plant", "law"), (plant.engine, law), calls, strict=True):
        setattr(loop, field, _engine(engine, call, kept))
    delay, inputs, outputs = plant.delay, plant.engine.inputs, plant.engine.outputs
    _, later, earlier, part = zip(*delay.motors, strict=True)
    views = {
        "state": inputs["state"],
        "state_out": outputs["state"],
        "memory": law.inputs["memory"],
        "memory_out": law.outputs["memory"],
        "motors": law.outputs["motor_command"],
        "command": inputs["command"],
        "sent": delay.sent,
        "later": memoryview(array("q", later)),
        "earlier": memoryview(array("q", earlier)),
        "part": memoryview(array("d", part)),
        "sensed": outputs["sensed"],
        "samples": samples,
        "noise": inputs["noise"],
        "gyro": law.inputs["gyro"],
        "force": law.inputs["specific_force"],
        "piece_s": law.inputs["piece"],
        "yaw_s": law.inputs["yaw_piece"],
        "saturated": law.outputs["saturated"],
    }
    for name, view in views.items():
        setattr(loop, name, address(view))
    for name in ("state", "memory", "sent"):
        setattr(loop, f"{name}_bytes", views[name].nbytes)
    kept += [loop, views]
    ticks = library.ticks
    ticks.argtypes = [ctypes.c_void_p, *[ctypes.c_longlong] * 5, ctypes.c_void_p, ctypes.c_void_p]
    ticks.restype = ctypes.c_longlong
    pointer = ctypes.addressof(loop)

    def run(*arguments: int | None, kept: list[Any] = kept) -> int:
        return ticks(pointer, *arguments)

    return run


def _engine(engine: CompiledEngine, call: Any, kept: list[Any]) -> _Engine:
    """Return the C struct `engine`; what it points to is added to `kept`."""
    function = engine.function
    arg, res = (ctypes.c_void_p * function.sz_arg())(), (ctypes.c_void_p * function.sz_res())()
    for pointers, views in ((arg, engine.inputs), (res, engine.outputs)):
        for k, view in enumerate(views.values()):
            pointers[k] = address(view)
    iw, w = (ctypes.c_longlong * (function.sz_iw() + 1))(), (ctypes.c_double * (function.sz_w() + 1))()
    kept += [arg, res, iw, w]
    return _Engine(ctypes.cast(call, ctypes.c_void_p).value, *map(ctypes.addressof, (arg, res, iw, w)))
