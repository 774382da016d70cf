"""Content of a controller file, as frozen types with the keys of the file.

A file of kind "mpc" sets a controller on the host, which streams commands. A file of kind "dfbc" sets the
controller on board, through parameters of the firmware.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from trimtab.host.vehicle import Vehicle, to_parameters
from trimtab.host.vehicle.model import Name, NonNegative, NonNegative3, Positive, Positive3
from trimtab.host.vehicle.strict_toml import Strict

STAGES_MAX = 100
Course = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*(:[0-9]+)?$")]
"""Name of a route, or `random:SEED`."""


class Tuned(Strict):
    """What the settings were tuned on."""

    vehicle: Name
    courses: Annotated[tuple[Course, ...], Field(min_length=1)]
    paces: Annotated[tuple[Positive, ...], Field(min_length=1)]
    """Over the times of the courses."""
    world: Name
    """Simulated world."""
    world_seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]
    command: str
    """Command that repeats the tuning."""


class GainFactors(Strict):
    """Factors on gains of the vehicle file. They fit vehicles of every size."""

    position_p: Positive = 1.0
    velocity_d: Positive = 1.0
    attitude_p: Positive = 1.0
    rate_p: Positive = 1.0
    rate_i: Positive = 1.0
    rate_d: Positive = 1.0


class DfbcSettings(Strict):
    """The flatness-based controller on board."""

    kind: Literal["dfbc"]
    observer_bandwidth_1_s: NonNegative
    """Bandwidth of the disturbance observer (parameter OBS_GAIN); 0 for none."""
    feedforward: bool
    """Whether the flight needs a feed-forward of the learned residual on board."""
    gain_factors: GainFactors = GainFactors()
    tuned: Tuned | None = None

    def parameters(self, vehicle: Vehicle) -> dict[str, float]:
        """Return a value for every parameter of the firmware: the vehicle's, with these settings.

        Raises ConfigurationError for values that the firmware does not accept.
        """
        gains = vehicle.gains.model_dump()
        for name, factor in self.gain_factors.model_dump().items():
            gains[name] = tuple(factor * gain for gain in gains[name])
        gains["observer"] = self.observer_bandwidth_1_s
        return to_parameters(vehicle.replace(gains=gains))


class Weights(Strict):
    """Weights of the squared deviations from the targets; the cost has no unit."""

    position_1_m2: NonNegative3
    """NED."""
    velocity_s2_m2: NonNegative3
    """NED."""
    attitude_1_rad2: NonNegative3
    """Roll, pitch and yaw."""
    rate_s2_rad2: NonNegative3
    """Body rate, FRD."""
    rate_command_s2_rad2: Positive3
    """Commanded body rate, FRD."""
    thrust_command: Positive
    """Commanded collective thrust over the weight."""
    tilt: NonNegative
    """Shortfall of cos(tilt) below that of the vehicle's tilt limit."""
    terminal: Positive
    """Factor on the weights of the state at the end of the horizon."""


class AdaptationSettings(Strict):
    """The L1-adaptive estimate of a constant disturbance."""

    predictor_1_s: Positive
    """Decay of the velocity predictor's error."""
    bandwidth_1_s: Positive
    """Bandwidth of the filter on the estimate."""


class MpcSettings(Strict):
    """The model predictive controller on the host."""

    kind: Literal["mpc"]
    horizon_s: Annotated[float, Field(gt=0.0, le=5.0)]
    step_s: Annotated[float, Field(ge=0.005, le=0.2)]
    """Length of a stage, and the time between two control steps; whole milliseconds."""
    computing_time_s: Annotated[float, Field(ge=0.0, le=0.2)]
    """Time after a control step that its command needs before it is sent; whole milliseconds."""
    iterations_max: Annotated[int, Field(ge=1, le=100)]
    tolerance: Annotated[float, Field(gt=0.0, le=0.1)]
    """Distance of an input from the solution, as a share of its range, at which a solve ends."""
    residual: Literal["none", "model"]
    """Whether the prediction has the residual acceleration of a model file."""
    rate_lag_s: Positive3 | None = None
    """Lag of the rate loop about the body axes. By default that of the vehicle's gains."""
    weights: Weights
    adaptation: AdaptationSettings | None = None
    tuned: Tuned | None = None

    @model_validator(mode="after")
    def _whole_stages(self) -> Self:
        for name, value in (("step_s", self.step_s), ("computing_time_s", self.computing_time_s)):
            if abs(1e3 * value - round(1e3 * value)) > 1e-6:
                raise ValueError(f"{name}: {value:g} s is no whole number of milliseconds; round it")
        stages = self.horizon_s / self.step_s
        if abs(stages - round(stages)) > 1e-6 or not 2 <= round(stages) <= STAGES_MAX:
            raise ValueError(
                f"horizon_s: {self.horizon_s:g} s are {stages:.6g} steps of {self.step_s:g} s; "
                f"give a whole number from 2 to {STAGES_MAX}"
            )
        return self

    @property
    def stages(self) -> int:
        """Number of stages in the horizon."""
        return round(self.horizon_s / self.step_s)

    @property
    def step_us(self) -> int:
        """Length of a stage."""
        return 1000 * round(1e3 * self.step_s)

    @property
    def computing_time_us(self) -> int:
        """Declared computing time."""
        return 1000 * round(1e3 * self.computing_time_s)


ControllerSettings = DfbcSettings | MpcSettings
