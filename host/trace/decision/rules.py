"""The thresholds of tracing: one frozen table, each entry with its unit, its meaning and where it comes from.

An effect's own tolerances, discrepancies and aliases stand on the effect (`trimtab.host.effects`). Steps of
difference quotients, iteration counts and other settings of numerical methods stand beside the method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

MEASURED = "measured"
"""Measured in simulated worlds without effects; `trimtab study calibrate` repeats the measurement."""
CHOSEN = "chosen"
"""A definition or a judgement. No measurement stands behind it."""


def _rule(value: Any, unit: str, meaning: str, source: str = CHOSEN) -> Any:
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True, kw_only=True)
class Rules:
    """Every threshold that a trace decides by. `table()` lists them with unit, meaning and source."""

    # Evidence: which sets of effects explain the flights, and how sure that is.
    odds: float = _rule(
        20.0, "1", "Odds that count as decided: less evidence leaves an alternative open, more excludes it."
    )
    prior_odds: float = _rule(40.0, "1", "Prior odds against the presence of any one effect.")
    slab_sigma: float = _rule(
        2.0, "typical sizes", "Prior standard deviation of a parameter whose effect is selected."
    )
    disturbance_correlation: float = _rule(
        0.75, "1", "Correlation of the process disturbance between neighbouring bins of 0.1 s."
    )
    max_effects: int = _rule(6, "effects", "Most effects in one set.")
    worth_fitting_nats: float = _rule(
        12.0, "nats", "A set whose screened evidence is this far behind the best is not fitted."
    )
    present_tolerances: float = _rule(
        1.0, "tolerances", "An effect is present if its greatest parameter is further than this from neutral."
    )
    carrier_tolerances: float = _rule(
        4.0, "tolerances", "An effect carries another one (drag carries wind) if it is larger than this."
    )
    worse_fit_ratio: float = _rule(
        1.5,
        "1",
        "A set whose position error is this many times that of the set it was made from is rejected.",
    )
    memory_fault_share: float = _rule(
        0.1,
        "1",
        "Beside an effect with states of its own, another effect must explain this share of the log evidence "
        "that something repeats.",
    )
    detectable_sigma: float = _rule(
        4.2, "sigma", "Separation at which an effect shows, and at which two effects are told apart."
    )

    majority: float = _rule(
        0.5, "1", "Probability above which the answer says that something unnamed is missing."
    )
    open_probability: float = _rule(
        0.5, "1", "Probability of an alternative that nothing in the data speaks against."
    )

    # Unexplained residual: what the selected effects leave behind.
    repeat_z: float = _rule(3.0, "sigma", "Score above which a residual repeats between twin flights.")
    force_floor_m_s2: float = _rule(
        0.06, "m/s^2", "Specific force below which a residual needs no cause: the level of turbulence."
    )
    torque_floor_rad_s2: float = _rule(
        0.8, "rad/s^2", "Angular acceleration below which a residual needs no cause."
    )
    form_error_share: float = _rule(
        0.1, "1", "Share of the residual without any effect that may remain: no form is exact."
    )
    line_ratio: float = _rule(
        3.5, "1", "Power of a spectral line over its surroundings above which the residual rings."
    )
    line_ratio_with_memory: float = _rule(
        10.0, "1", "The same where an effect with states of its own is selected: some of its swing remains."
    )
    line_false_alarm: float = _rule(
        1e-3, "probability", "A line counts if noise alone shows one as strong less often than this."
    )
    line_min_hz: float = _rule(0.3, "Hz", "Lowest frequency at which a line is looked for.")
    line_max_hz: float = _rule(4.0, "Hz", "Highest frequency at which a line is looked for.")
    excited_power_share: float = _rule(
        0.02, "1", "Share of the motion's strongest frequency above which a frequency counts as flown."
    )
    flight_repeat_share: float = _rule(
        0.08,
        "1",
        "Repeatable power of whole flights, over turbulence and noise and two standard errors down, above "
        "which it needs a cause.",
    )
    repeat_standard_errors: float = _rule(
        2.0, "standard errors", "How far below its estimate a repeatable power is taken to be."
    )
    flight_form_amplitude: float = _rule(
        0.2, "1", "Share of the repeatable amplitude without any effect that may remain: no form is exact."
    )
    worsened_ratio: float = _rule(
        1.5, "1", "Effects that make the repeatable position error this many times larger are rejected."
    )
    worsened_m: float = _rule(0.01, "m", "The same: and larger than this.")
    repeat_shift_s: float = _rule(
        1.0, "s", "Twins shifted by more than this have nothing in common but by chance."
    )
    repeat_min_s: float = _rule(3.0, "s", "Shortest common time of two repeat_flights that is compared.")
    excess_force_m_s2: float = _rule(
        0.5, "m/s^2", "Disturbance force above which it is more than indoor turbulence, if no twin tells."
    )
    excess_torque_rad_s2: float = _rule(3.0, "rad/s^2", "The same for the angular acceleration.")

    # Uncertainty.
    temper: float = _rule(
        2.0,
        "1",
        "Whitened residuals count for 1/this where sizes are estimated: the innovations keep what is slower "
        "than the windows.",
        MEASURED,
    )
    min_widening: float = _rule(
        math.sqrt(2.0),
        "1",
        "Least factor on the standard deviations of an estimate over whole flights.",
        MEASURED,
    )
    jackknife_prior_flights: float = _rule(
        7.0,
        "flights",
        "Flights that the jackknife is taken to have seen spread as the median parameter does.",
    )
    jackknife_pieces: int = _rule(
        4, "pieces", "Fewer flights than this are cut into as many pieces each for the jackknife."
    )

    # Amount and noise of the data.
    position_sigma_floor_m: float = _rule(
        1e-3, "m", "Least standard deviation of a pose's position: smoothed logs look quieter than they are."
    )
    attitude_sigma_floor_rad: float = _rule(3e-3, "rad", "The same for the attitude.")
    rate_sigma_floor_rad_s: float = _rule(5e-3, "rad/s", "The same for the body rate.")
    force_sigma_floor_m_s2: float = _rule(0.02, "m/s^2", "The same for the specific force.")
    mounting_sigma_rad: float = _rule(
        0.001, "rad", "Prior standard deviation of the markers' mounting tilt, of one flight."
    )
    free_mounting_sigma_rad: float = _rule(0.1, "rad", "The same where the log declares the tilt unknown.")
    torque_sigma_rad_s2: float = _rule(
        0.3, "rad/s^2", "Prior standard deviation of a flight's own constant angular acceleration."
    )
    gyro_bias_sigma_rad_s: float = _rule(
        0.02, "rad/s", "Prior standard deviation of a flight's own gyro bias, where the torque is unknown."
    )
    force_bias_sigma_m_s2: float = _rule(
        0.05, "m/s^2", "Prior standard deviation of a flight's own accelerometer bias."
    )
    free_force_bias_sigma_m_s2: float = _rule(
        0.5, "m/s^2", "The same where the log declares the mounting tilt unknown."
    )
    min_segments: int = _rule(5, "segments", "Fewest usable segments that are traced.")
    min_poses: int = _rule(100, "poses", "Fewest poses of a log.")
    min_tracking_poses: int = _rule(10, "poses", "Fewest poses in the tracking phase of a log.")
    flight_fit_min_s: float = _rule(
        9.6, "s", "Least tracking time for a fit over whole flights: 20 bins of 40 ms for each channel."
    )
    hover_extent_m: float = _rule(
        0.3, "m", "Extent below which a flight is a hover: whitened, what is constant in it does not show."
    )
    bins_per_order: int = _rule(
        168, "bins", "Bins that one more order of the autoregression needs: 14 for each coefficient."
    )
    missing_share: float = _rule(
        0.4, "1", "A segment that misses more of its commands or poses than this is left out."
    )
    min_coverage: float = _rule(
        0.5, "1", "Share of a step or window that must hold data for its mean to count."
    )
    calibration_share: float = _rule(
        0.25,
        "1",
        "Share of a held-out flight that its own nuisances are fitted to, if inputs drive the model.",
    )

    # Health of the data.
    gap_s: float = _rule(0.2, "s", "Longest time without poses or commands that is bridged.")
    saturation_s: float = _rule(
        0.1, "s", "A motor command at its limit for longer than this ends the use of the flight."
    )
    saturation_low: float = _rule(0.01, "1", "Mean motor command that counts as 0.")
    saturation_high: float = _rule(0.99, "1", "Mean motor command that counts as 1.")
    saturation_share: float = _rule(
        0.01, "1", "Share of ticks with saturated rotors above which the audit warns."
    )
    tilt_max_rad: float = _rule(
        math.radians(75.0), "rad", "Tilt above which a flight is not used: no model of a hovering vehicle."
    )
    pitch_max_rad: float = _rule(
        math.radians(80.0), "rad", "Pitch above which a flight is not used: Euler angles become singular."
    )
    clock_jump_s: float = _rule(
        0.003, "s", "Step of the least pose delay above which a clock has jumped: five latency tolerances."
    )
    clock_drift_s: float = _rule(
        0.002, "s", "Drift between the clocks of camera and vehicle above which the audit warns."
    )
    clear_m: float = _rule(
        0.05, "m", "Height over where the vehicle rested below which it may touch the floor."
    )
    low_m: float = _rule(
        0.1, "m", "Height over the lowest place of a log without a floor below which it may be supported."
    )
    support_ratio: float = _rule(
        1.3, "1", "Specific force over rotor thrust, relative to free flight, above which the floor carries."
    )
    level_speed_m_s: float = _rule(0.15, "m/s", "Vertical speed below which a vehicle does not fall.")
    powered_share: float = _rule(
        0.5, "1", "Share of the median rotor thrust in flight above which the rotors carry the vehicle."
    )
    impact_g: float = _rule(
        2.0, "g", "Specific force beyond what the rotors give above which something hit the vehicle."
    )
    free_height_m: float = _rule(0.3, "m", "Height above the lowest place at which a vehicle flies free.")
    still_m: float = _rule(0.02, "m", "Extent over 0.3 s below which a vehicle rests.")
    resting_thrust_g: float = _rule(
        0.3, "g", "Specific thrust below which a still vehicle rests on the floor."
    )
    sparse_rate_hz: float = _rule(
        20.0, "Hz", "Median rate below which a topic is not checked for seconds with few samples."
    )
    rate_drop_share: float = _rule(
        0.5, "1", "A topic whose leanest second has fewer samples than this share of the median is reported."
    )

    # Description of what is outside the library.
    min_skill: float = _rule(
        0.1, "1", "Held-out share of the variance below which a dependence is not reported."
    )
    clear_form_skill: float = _rule(
        0.5, "1", "Held-out skill above which a closed form of the force is reported."
    )
    form_skill_margin: float = _rule(
        0.05, "1", "How far a simpler closed form may fall behind a richer one and still be preferred."
    )
    leading_share: float = _rule(
        0.35, "1", "Slopes that do at least this share of the strongest are reported."
    )
    shown_slack_m: float = _rule(0.1, "m", "Free length of a tether above which the description mentions it.")
    one_heading: float = _rule(
        0.995, "1", "Mean resultant length of the heading above which all was flown in one heading."
    )

    @property
    def tie_nats(self) -> float:
        """Return the difference of log evidence that is not yet decided, in nats."""
        return math.log(self.odds)

    @property
    def alias_probability(self) -> float:
        """Return the probability above which an alternative is not excluded."""
        return 1.0 / self.odds

    @property
    def undecided_sigma(self) -> float:
        """Return the separation that leaves an alias a probability of 1/odds, in sigma."""
        return math.sqrt(2.0 * math.log(self.odds))

    @property
    def prior_log_odds(self) -> float:
        """Return the prior log odds of any one effect."""
        return math.log(1.0 / self.prior_odds)


RULES = Rules()
"""The rules in force."""


class RuleRow(NamedTuple):
    """One row of the table: name, value, unit, meaning, and where the value comes from."""

    name: str
    value: float
    unit: str
    meaning: str
    source: str


def table(rules: Rules = RULES) -> list[RuleRow]:
    """Return every rule with its value, unit, meaning and source, in the order of the definition."""
    return [
        RuleRow(
            name=f.name,
            value=getattr(rules, f.name),
            unit=f.metadata["unit"],
            meaning=f.metadata["meaning"],
            source=f.metadata["source"],
        )
        for f in fields(rules)
    ]
