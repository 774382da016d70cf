"""World files: physics, sensors and radio of a simulated flight, read strictly from TOML.

A world states effects with their values, or kinds of effect to draw. The seed of the draw is not in the file.
Keys that are left out have the defaults below.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, ValidationInfo, create_model, field_validator

from trimtab.host.base import bounds
from trimtab.host.vehicle import ConfigurationError
from trimtab.host.vehicle.strict_toml import Strict, read_strict
from trimtab.protocol.telemetry import TICK_US
from trimtab.protocol.uwb_pieces import FRAME_BYTES, FRAME_BYTES_MIN
from trimtab.sitl.air_time import air_us
from trimtab.sitl.kinds import DRAG, KINDS

Share = Annotated[float, Field(ge=0.0, le=1.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
MicrosecondsUp = Annotated[int, Field(ge=0, le=1_000_000)]
Spell = tuple[NonNegative, Annotated[float, Field(gt=0.0)]]
"""[start, length] in seconds."""


class Turbulence(Strict):
    """Random disturbance of the body, drawn for each flight."""

    force_m_s2: NonNegative = 0.04
    """Standard deviation of each axis in NED, as acceleration."""
    torque_rad_s2: NonNegative = 0.5
    """Standard deviation of each axis in FRD, as angular acceleration."""
    correlation_s: Annotated[float, Field(gt=0.0)] = 0.3
    spectrum: Literal["ornstein-uhlenbeck", "dryden"] = "ornstein-uhlenbeck"
    """dryden: gusts along east and down, and in pitch and yaw, have Dryden's transverse spectrum."""


class Build(Strict):
    """Deviations of the build from the vehicle file, if the world has tolerances."""

    distribution: Literal["normal", "student-t"] = "normal"
    """Distribution of a deviation over its tolerance. student-t: with 3 degrees of freedom."""
    clip: Annotated[float, Field(gt=0.0)] | None = None
    """Greatest deviation, in tolerances. Default: none."""


class Battery(Strict):
    """The battery. In a world with battery-sag it always discharges, and thrust falls with its voltage."""

    discharges: bool = False
    """Whether the voltage falls under load and with the charge. Without battery-sag, the motor controllers
    then compensate for it: thrust does not depend on the voltage, up to the tolerance of battery-sag.
    """


class MocapSettings(Strict):
    """The camera system."""

    rate_hz: Annotated[int, Field(ge=10, le=250)] = 100
    """A faster system would take every uplink slot of the radio."""
    position_noise_m: NonNegative = 0.001
    attitude_noise_deg: NonNegative = 0.3
    delay_us: MicrosecondsUp = 4000
    """Declared delay: time from exposure, which is the stamp, to arrival at the host."""
    delay_jitter_us: MicrosecondsUp = 500
    dropout: Share = 0.002
    """Share of single poses that never arrive."""
    gaps_s: tuple[Spell, ...] = ()
    """[start, length] of periods without poses."""

    @field_validator("rate_hz")
    @classmethod
    def _divides_tick(cls, value: int) -> int:
        if 1_000_000 % (value * TICK_US):
            raise ValueError(f"{value} does not divide 1000 ticks a second; choose 50, 100, 125, 200 or 250")
        return value


class ImuSettings(Strict):
    """Gyro, accelerometer and voltage measurement: white noise every tick, a bias drawn for each flight."""

    gyro_noise_rad_s: NonNegative = 0.02
    gyro_bias_rad_s: NonNegative = 0.004
    accelerometer_noise_m_s2: NonNegative = 0.08
    accelerometer_bias_m_s2: NonNegative = 0.01
    voltage_noise_v: NonNegative = 0.005


class RadioSettings(Strict):
    """The channel between the two radios. Each direction loses frames independently."""

    slot_us: Annotated[int, Field(ge=TICK_US, le=3000)] = 2000
    """Half-duplex slot for one frame of one radio. With longer slots, control telemetry takes all."""
    frame_bytes: Annotated[int, Field(ge=FRAME_BYTES_MIN, le=FRAME_BYTES)] = FRAME_BYTES
    """Payload of a frame. Longer messages are split."""
    bit_rate: Annotated[Literal[850_000, 6_800_000] | None, Field(validate_default=True)] = None
    """bit/s in the air. Without it, a frame of any length takes its whole slot."""
    loss: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.01
    """Long-run share of full frames lost; shorter frames are lost less often."""
    burst_frames: Annotated[float, Field(ge=1.0, validate_default=True)] = 5.0
    """Mean length of a burst of losses (Gilbert-Elliott)."""
    short_risk: Share = 0.5
    """Probability that a very short frame is lost in a burst; a full frame always is."""
    latency_us: MicrosecondsUp = 3000
    """Time from the end of the frame to delivery."""
    jitter_us: MicrosecondsUp = 1000
    """Greatest addition to the latency, uniform. Beyond one slot, frames overtake each other."""
    duplicate: Share = 0.002
    corrupt: Share = 0.001
    """Share of frames delivered with flipped bits."""
    cuts_s: tuple[Spell, ...] = ()
    """[start, length] of periods in which no frame passes in either direction."""
    wired: bool = False
    """No radios: the host's serial line leads to the flight processor."""

    @field_validator("wired")
    @classmethod
    def _alone(cls, value: bool, info: ValidationInfo) -> bool:
        changed = [k for k, v in info.data.items() if v != cls.model_fields[k].default]
        if value and changed:
            raise ValueError(f"a wired host has no radios; leave out {', '.join(changed)}")
        return value

    @field_validator("burst_frames")
    @classmethod
    def _long_enough_for_loss(cls, value: float, info: ValidationInfo) -> float:
        # At least one frame passes between two bursts, so bursts of n lose at most n of n + 1 frames.
        loss, loss_max = info.data.get("loss", 0.0), value / (value + 1.0)
        if loss > loss_max:
            raise ValueError(
                f"bursts of {value:g} frames lose at most {loss_max:.4g} of all; lower loss {loss:g} "
                f"or give at least {loss / (1.0 - loss):.4g}"
            )
        return value

    @field_validator("bit_rate")
    @classmethod
    def _fits_slot(cls, value: int | None, info: ValidationInfo) -> int | None:
        slot_us, size = info.data.get("slot_us"), info.data.get("frame_bytes")
        if value is None or slot_us is None or size is None:
            return value
        if (needed_us := air_us(size, value)) > slot_us:
            raise ValueError(
                f"a frame of {size} B takes {needed_us} us at {value} bit/s and slot_us is {slot_us}; "
                "give a longer slot, a higher rate or smaller frame_bytes"
            )
        return value

    @field_validator("slot_us")
    @classmethod
    def _whole_ticks(cls, value: int) -> int:
        if value % TICK_US:
            raise ValueError(f"{value} is not a multiple of the tick of {TICK_US} us; give one")
        return value


class SerialSettings(Strict):
    """The serial lines between host, radios and flight processor."""

    baud: Literal[921_600, 3_000_000] = 921_600
    chunk_bytes: Annotated[int, Field(ge=1, le=65_536)] | None = None
    """Number of received bytes that interrupts a processor. Default: half its receive buffer."""
    idle_us: MicrosecondsUp = 0
    """Idle time of the line that also interrupts a processor."""


class TimingSettings(Strict):
    """The flight processor's tick of 1 ms, drawn for each flight. Longer work delays the next tick."""

    work_us: NonNegative = 320.0
    """Mean duration of a tick's work."""
    work_spread_us: NonNegative = 25.0
    """Standard deviation of the duration."""
    jitter_us: Annotated[float, Field(ge=0.0, lt=TICK_US)] = 5.0
    """Greatest deviation of a tick's start, uniform."""
    overrun: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """Share of ticks whose work takes longer than a tick."""
    overrun_us: Annotated[int, Field(gt=TICK_US, le=1_000_000)] = 3000
    """Greatest duration of such work, uniform from 1 ms."""


class Draw(Strict):
    """Effects to draw from the seed."""

    count: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]]
    """Smallest and greatest number of kinds."""
    kinds: Annotated[tuple[str, ...], Field(min_length=1, validate_default=True)] = tuple(
        k.name for k in KINDS.values() if not k.outside
    )
    size: tuple[Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)]] = (0.5, 2.0)
    """Smallest and greatest multiple of the typical size."""
    uniform: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Other intervals, by "kind.key", of values that are drawn uniformly: places, directions, lengths."""

    @field_validator("uniform")
    @classmethod
    def _within_bounds(cls, value: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        known = {
            f"{kind.name}.{q.key}": q
            for kind in KINDS.values()
            for q in kind.quantities
            if q.drawn is not None
        }
        for name, (low, high) in value.items():
            if name not in known:
                raise ValueError(f"unknown {name}; choose from {', '.join(known)}")
            if not known[name].lower <= low <= high <= known[name].upper:
                raise ValueError(
                    f"{name} = {[low, high]} is not an interval within {known[name].lower:g} to "
                    f"{known[name].upper:g}; give [low, high]"
                )
        return value

    @field_validator("kinds")
    @classmethod
    def _known_and_enough(cls, value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        unknown = [name for name in value if name not in KINDS]
        if unknown:
            raise ValueError(f"unknown {', '.join(unknown)}; choose from {', '.join(KINDS)}")
        if len(set(value)) < len(value):
            raise ValueError("a kind is named twice; name each once")
        count_max = info.data.get("count", (0, 0))[1]
        if count_max > len(value):
            raise ValueError(f"count is up to {count_max} of {len(value)} kinds; lower it or name more")
        return value

    @field_validator("count", "size")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError(f"{list(value)} is not an interval; give [low, high]")
        return value


def _effect_tables() -> type[Strict]:
    """Return a model with one optional table for each kind, whose values are mandatory and bounded."""
    tables: dict[str, Any] = {}
    for name, kind in KINDS.items():
        fields: dict[str, Any] = {
            q.key: (Annotated[float, Field(ge=q.lower, le=q.upper)], ...) for q in kind.quantities
        }
        identifier = name.replace("-", "_")
        table = create_model(identifier, __base__=Strict, **fields)
        tables[identifier] = (table | None, Field(default=None, alias=name))
    return create_model("Effects", __base__=Strict, **tables)


if TYPE_CHECKING:
    Effects = Strict
else:
    Effects = _effect_tables()


class WorldFile(Strict):
    """Content of a world file."""

    description: str
    tolerances: bool
    """Whether the build deviates from the vehicle file within its tolerances. Drawn from the seed."""
    effects: Effects = Effects()
    draw: Draw | None = None
    build: Build = Build()
    battery: Battery = Battery()
    turbulence: Turbulence = Turbulence()
    mocap: MocapSettings = MocapSettings()
    imu: ImuSettings = ImuSettings()
    radio: RadioSettings = RadioSettings()
    serial: SerialSettings = SerialSettings()
    timing: TimingSettings = TimingSettings()

    @property
    def stated(self) -> dict[str, dict[str, float]]:
        """The effects with values in the file, by name."""
        return _stated(self.effects)

    @field_validator("effects")
    @classmethod
    def _wind_needs_drag(cls, value: Effects) -> Effects:
        stated = _stated(value)
        if "wind" in stated and not set(stated) & set(DRAG):
            raise ValueError(f"wind acts only through drag; add {' or '.join(DRAG)}")
        return value

    @field_validator("draw")
    @classmethod
    def _draw_goes_with_effects(cls, value: Draw | None, info: ValidationInfo) -> Draw | None:
        if value is None or "effects" not in info.data:
            return value
        stated, drawn = set(_stated(info.data["effects"])), set(value.kinds)
        if twice := sorted(stated & drawn):
            raise ValueError(f"{', '.join(twice)} both in effects and in draw.kinds; leave out one")
        if drawn == {"wind"} and not stated & set(DRAG):
            raise ValueError(f"kinds has wind without a drag; add {' or '.join(DRAG)}")
        return value


def _stated(effects: Effects) -> dict[str, dict[str, float]]:
    """Return the effects that have a table, with their values, by name."""
    tables = ((name, getattr(effects, name.replace("-", "_"))) for name in KINDS)
    return {name: table.model_dump() for name, table in tables if table is not None}


def load_world(name_or_path: str | Path) -> tuple[str, WorldFile]:
    """Return name and content of a world, given by the path of a TOML file or the name of a shipped world.

    Raises ConfigurationError (exit code 2) if there is no such file, or with every problem in it.
    """
    shipped = list_worlds()
    text = str(name_or_path)
    if text in shipped:
        path = shipped[text]
    elif text.endswith(".toml") or "/" in text:
        path = Path(text)
        if not path.is_file():
            raise ConfigurationError([f"{text}: no such world file; check the path"])
    else:
        raise ConfigurationError(
            [f"{text}: no such world (known: {', '.join(shipped)}); give one or a path to a .toml"]
        )
    try:
        content = bounds.read_text(path, bounds.TOML_BYTES)
    except bounds.TooLarge as error:
        raise ConfigurationError([f"{text}: {error}"]) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError([f"{text}: cannot be read ({error}); check the file"]) from None
    return path.stem, read_strict(content, text, WorldFile)


def list_worlds() -> dict[str, Path]:
    """Return the files of all shipped worlds by sorted name."""
    folder = Path(str(files("trimtab.sitl") / "worlds"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}
