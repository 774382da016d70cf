"""The thresholds of tracing: one frozen table with the unit, meaning and source of each entry.

Tolerances, discrepancies and aliases of an effect are defined with the effect (`trimtab.host.effects`). Steps
of difference quotients, iteration counts and other settings of numerical methods are defined with the method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

MEASURED = "measured"
"""Measured in simulated worlds without effects; `trimtab study calibrate` repeats the measurement."""
CHOSEN = "chosen"
"""A definition or a judgement, without a measurement."""


def _rule(value: Any, unit: str, meaning: str, source: str = CHOSEN) -> Any:
    """Return a dataclass field with its unit, meaning and source as metadata."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The thresholds of a trace. `table()` lists them with unit, meaning and source."""

    # Evidence: which sets of effects explain the flights, and how sure that is.
    odds: float = _rule(
        20.0, "1", "Odds above which evidence excludes an alternative; below, the alternative stays open."
    )
    prior_odds_against: float = _rule(40.0, "1", "Prior odds against the presence of each effect.")
    slab_sigma: float = _rule(
        2.0, "typical sizes", "Prior standard deviation of a parameter whose effect is selected."
    )
    slab_halvings: int = _rule(
        3,
        "halvings",
        "The order of magnitude of an effect is unknown: its prior standard deviation is `slab_sigma`, or "
        "that halved once, and so on up to this many times, each with the same probability.",
    )
    disturbance_correlation: float = _rule(
        0.75, "1", "Correlation of the process disturbance between neighbouring bins of 0.1 s."
    )
    max_effects: int = _rule(6, "effects", "Most effects in one set.")
    worth_fitting_nats: float = _rule(
        12.0,
        "nats",
        "A set with one effect fewer, or with an alias in place of an effect, is not fitted if the screening "
        "puts it farther than this below the best. A start value of an effect is used only if it gains more "
        "than this.",
    )
    hopeless_nats: float = _rule(
        30.0,
        "nats",
        "A fit to whole flights keeps slopes of absent effects from nearby if it ends farther than this "
        "below its start.",
    )
    noise_dependent_spikes: float = _rule(
        2.5,
        "spikes",
        "Segments show an effect that depends on noise if it is farther than this from neutral in their fit "
        "without effects. Effects are then selected from segments.",
    )
    usual_variance_factor: float = _rule(
        1.5,
        "1",
        "Variance of the residual of segments over that of the stated sensor noise up to which it counts as "
        "usual. Beyond, all information of the segments is divided by the excess.",
    )
    form_share: float = _rule(
        0.1,
        "1",
        "Share of the nats that a set gains that the form of an effect may decide. An alias of a selected "
        "effect is fitted if the screening, which lacks its form, puts it no farther than this below.",
    )
    swap_share: float = _rule(
        0.5,
        "1",
        "The best set with another effect in place of one is not fitted if the screening puts it farther "
        "below the best set than this share of what the best set gains.",
    )
    present_spikes: float = _rule(
        1.0,
        "spikes",
        "An effect is present if a strength parameter is farther than this from neutral, in units of the "
        "spike (tolerance and discrepancy combined).",
    )
    present_sigma: float = _rule(
        2.0,
        "sigma",
        "An effect is present if the fit that is weighted by turbulence and noise puts it farther than this "
        "from neutral, in reported standard deviations.",
    )
    far_tolerances: float = _rule(
        2.0,
        "tolerances",
        "An adjustment farther than this from neutral is told: the model takes it up without naming it.",
    )
    carrier_spikes: float = _rule(
        4.0,
        "spikes",
        "Another effect can act through an effect larger than this, as wind through drag, in units of the "
        "spike (tolerance and discrepancy combined).",
    )
    far_error_m: float = _rule(
        0.05,
        "m",
        "If whole flights without effects have a greater position error, their search may start from the set "
        "that segments suggest.",
    )
    worse_fit_ratio: float = _rule(
        1.5,
        "1",
        "A set is rejected if its position error is this many times that of the set that it started from.",
    )
    least_gain_beside_memory: float = _rule(
        0.1,
        "1",
        "If an effect with states of its own is selected, an additional effect is kept only if it gains at "
        "least this share of the nats that a perfect model would gain.",
    )
    memory_form_share: float = _rule(
        0.01,
        "1",
        "Share of the nats that an effect with states of its own gains. An additional effect that exceeds it "
        "by `odds` is kept in any case: the form is wrong by about a tenth, and nats go with the square.",
    )
    unsupported_share: float = _rule(
        0.25,
        "1",
        "If a set that is not supported explains segments better, an effect is kept only if it gains more "
        "than this share of that difference: signals of unlike effects are correlated by less than a half.",
    )
    detectable_sigma: float = _rule(
        4.2, "sigma", "Separation above which an effect is detectable and two effects are distinguished."
    )

    majority: float = _rule(
        0.5,
        "1",
        "If no effect is selected: probability of no change below which a comparison is `undecided`, and "
        "probability of a missing effect above which an `undecided` trace reports that one is missing.",
    )
    open_probability: float = _rule(
        0.5, "1", "Probability of an alternative about which the data contains no information."
    )

    # Unexplained residual.
    repeat_z: float = _rule(3.0, "sigma", "z score above which a residual repeats between repeat flights.")
    force_floor_m_s2: float = _rule(
        0.06,
        "m/s^2",
        "Residual specific force (rms that repeats, or of a line) that turbulence alone can show.",
    )
    torque_floor_rad_s2: float = _rule(0.8, "rad/s^2", "Residual angular acceleration that needs no cause.")
    equation_error_share: float = _rule(
        0.1,
        "1",
        "The selected set may leave this share of the residual that the model without effects leaves, since "
        "no effect's equation is exact.",
    )
    line_ratio: float = _rule(
        3.5, "1", "Power of a spectral line over its surroundings above which the residual rings."
    )
    line_ratio_with_memory: float = _rule(
        10.0, "1", "The same if an effect with states of its own is selected, whose swing partly remains."
    )
    line_false_alarm: float = _rule(
        1e-3,
        "probability",
        "A line counts if the probability that noise alone shows an equally strong line is below this.",
    )
    line_min_hz: float = _rule(0.3, "Hz", "Lowest frequency of the search for lines.")
    line_max_hz: float = _rule(4.0, "Hz", "Highest frequency of the search for lines.")
    pulse_ratio: float = _rule(
        0.95,
        "1",
        "Pulses of force at equal intervals over the greatest that noise of the same power may show, above "
        "which the force has a cause that moves by itself, such as a fan that sweeps.",
    )
    pulse_min_s: float = _rule(2.0, "s", "Shortest interval of the search for pulses.")
    pulse_max_s: float = _rule(5.5, "s", "Longest interval of the search for pulses.")
    excited_power_share: float = _rule(
        0.02,
        "1",
        "A frequency counts as excited by the motion if the motion has this share of its top power there.",
    )
    flight_repeat_share: float = _rule(
        0.08,
        "1",
        "Bound on the power of the part of the prediction error of whole flights that repeats, over that of "
        "turbulence and noise; a finding arises "
        "if the estimate minus `repeat_standard_errors` standard errors exceeds it.",
    )
    flight_repeat_chance: float = _rule(
        0.03,
        "1",
        "The same bound if no effect is selected and a position error of more than `visible_error_m` "
        "repeats: by chance, less does.",
    )
    visible_error_m: float = _rule(
        0.003,
        "m",
        "Smaller errors may come from the inexact forms of deviations within wide tolerances.",
    )
    repeat_standard_errors: float = _rule(
        2.0,
        "standard errors",
        "Subtracted from the estimate before it is compared with `flight_repeat_share` or "
        "`flight_repeat_chance`.",
    )
    equation_error_amplitude: float = _rule(
        0.2,
        "1",
        "The selected set may leave this share of the repeatable amplitude that the model without effects "
        "leaves, since no effect's equation is exact.",
    )
    equation_error_m: float = _rule(
        0.01,
        "m",
        "This holds only up to this repeatable position error, unless an effect with states of its own, such "
        "as a slung payload, is selected.",
    )
    worsened_ratio: float = _rule(
        1.5, "1", "Effects that increase the repeatable position error by more than this factor are rejected."
    )
    worsened_m: float = _rule(0.01, "m", "They are rejected only if the error is also larger than this.")
    repeat_shift_s: float = _rule(
        1.0, "s", "Repeat flights that are shifted by at least this much agree only by chance."
    )
    repeat_min_s: float = _rule(
        3.0, "s", "Shortest common duration for which two repeat flights are compared."
    )
    excess_force_m_s2: float = _rule(
        0.5, "m/s^2", "Greatest force of indoor turbulence; for flights without repeat flights."
    )
    excess_torque_rad_s2: float = _rule(
        3.0, "rad/s^2", "Greatest angular acceleration of indoor turbulence; likewise."
    )

    # Uncertainty.
    temper: tuple[float, ...] = _rule(
        (4.4, 2.7, 2.6, 2.0),
        "1",
        "Information of whitened residuals is divided by this, since they stay correlated beyond the windows "
        "of the autoregression (`whitening.WINDOWS`): for orders 1, 2, 3 and 4. Few flights determine a low "
        "order only.",
        MEASURED,
    )
    min_widening: float = _rule(
        1.44,
        "1",
        "Least factor by which standard deviations of flight fits are widened.",
        MEASURED,
    )
    min_widening_flights: float = _rule(
        8.0,
        "flights",
        "Flights with which `min_widening` was measured. With more, the excess of its square over 1 falls in "
        "inverse proportion to their number, since more flights determine the whitening better.",
    )
    widening_prior_flights: float = _rule(
        7.0,
        "flights",
        "The disagreement of flights about a parameter is averaged with the median of all parameters; the "
        "median weighs as much as this many flights.",
    )
    widening_pieces: int = _rule(
        4, "pieces", "If there are fewer flights than this, each is cut into this many pieces."
    )

    # Amount and noise of the data.
    position_sigma_floor_m: float = _rule(
        1e-3,
        "m",
        "Least standard deviation of a measured position, since smoothing hides noise in some logs.",
    )
    attitude_sigma_floor_rad: float = _rule(3e-3, "rad", "Least standard deviation of a measured attitude.")
    rate_sigma_floor_rad_s: float = _rule(5e-3, "rad/s", "Least standard deviation of a measured body rate.")
    force_sigma_floor_m_s2: float = _rule(0.02, "m/s^2", "Least standard deviation of a measured force.")
    mounting_sigma_rad: float = _rule(
        0.001, "rad", "Prior standard deviation of the mounting tilt of the markers in one flight."
    )
    free_mounting_sigma_rad: float = _rule(0.1, "rad", "The same if the log declares the tilt unknown.")
    torque_sigma_rad_s2: float = _rule(
        0.3, "rad/s^2", "Prior standard deviation of the constant torque error of one flight, over inertia."
    )
    gyro_bias_sigma_rad_s: float = _rule(
        0.02, "rad/s", "Prior standard deviation of the gyro bias of one flight, if the torque is unknown."
    )
    force_bias_sigma_m_s2: float = _rule(
        0.05, "m/s^2", "Prior standard deviation of the accelerometer bias of one flight."
    )
    free_force_bias_sigma_m_s2: float = _rule(
        0.5, "m/s^2", "The same if the log declares the mounting tilt unknown."
    )
    session_thrust_sigma: float = _rule(
        0.05,
        "1",
        "Prior standard deviation of the thrust scale of one session (battery, temperature, propellers), if "
        "two sets of flights are compared.",
    )
    min_segments: int = _rule(5, "segments", "Fewest usable segments for a trace.")
    min_poses: int = _rule(100, "poses", "Fewest poses in a log.")
    min_tracking_poses: int = _rule(10, "poses", "Fewest poses in the tracking phase of a log.")
    flight_fit_min_s: float = _rule(
        9.6,
        "s",
        "Least tracking time for a fit to whole flights: 240 bins of 40 ms, that is 20 bins for each of 12 "
        "channels.",
    )
    flight_fit_pose_s: float = _rule(
        0.04, "s", "Longest median interval between poses for a fit to whole flights, whose bins are as long."
    )
    hover_extent_m: float = _rule(
        0.3, "m", "Extent below which a flight is a hover; whitening removes the constant errors of a hover."
    )
    bins_per_order: int = _rule(
        168, "bins", "Bins needed per order: each order adds 12 coefficients per channel, at 14 bins each."
    )
    missing_share: float = _rule(
        0.4, "1", "A segment that lacks more than this share of its commands or poses is left out."
    )
    min_coverage: float = _rule(
        0.5, "1", "Share of a step or window that data must cover for its mean to count."
    )
    calibration_share: float = _rule(
        0.25,
        "1",
        "Share of a held-out flight to which its nuisances are fitted, if inputs drive the model.",
    )

    # Quality of the data.
    gap_s: float = _rule(0.2, "s", "Longest time without poses or commands that is bridged.")
    saturation_s: float = _rule(
        0.1, "s", "A stretch with a motor command at its limit for longer than this is not used."
    )
    saturation_low: float = _rule(0.01, "1", "Mean motor command below which it counts as 0.")
    saturation_high: float = _rule(0.99, "1", "Mean motor command above which it counts as 1.")
    saturation_share: float = _rule(
        0.01, "1", "Share of ticks with saturated rotors above which the audit warns."
    )
    tilt_max_rad: float = _rule(
        math.radians(75.0),
        "rad",
        "Parts of a flight with more tilt are not used, since no model of flight is valid there.",
    )
    pitch_max_rad: float = _rule(
        math.radians(80.0),
        "rad",
        "Parts of a flight with more pitch are not used, since Euler angles are singular.",
    )
    clock_jump_s: float = _rule(
        0.003,
        "s",
        "A clock has jumped if the smallest pose delay changes by more than this in a second: six latency "
        "tolerances.",
    )
    late_recovery_s: float = _rule(
        1.0,
        "s",
        "Time after late or wrongly stamped poses that is not used either: the loop recovers in it. Poses "
        "count as wrongly stamped beyond `clock_jump_s`.",
    )
    late_pose_s: float = _rule(
        0.05,
        "s",
        "A pose is late if it arrived by more than this later than the promptest of the hundred before and "
        "after it: five poses. In ten pairs of flights beside eight busy processes, delays below it moved no "
        "estimate.",
    )
    late_share: float = _rule(
        0.25,
        "1",
        "A flight of which more than this share would be left out since time ran late is not judged. With "
        "any such share, no cause is said to be outside the library.",
    )
    clock_drift_s: float = _rule(
        0.002, "s", "Drift between the clocks of camera and vehicle above which the audit warns."
    )
    clear_m: float = _rule(0.05, "m", "A vehicle less than this above its resting place may touch the floor.")
    low_m: float = _rule(
        0.1, "m", "Something may support a vehicle that is less than this above the lowest place of its log."
    )
    support_ratio: float = _rule(
        1.3,
        "1",
        "The floor carries a vehicle whose specific force over thrust, relative to free flight, exceeds "
        "this.",
    )
    level_speed_m_s: float = _rule(0.15, "m/s", "A vehicle with a lower vertical speed is not falling.")
    powered_share: float = _rule(
        0.5, "1", "Rotors with more than this share of the median thrust in flight carry the vehicle."
    )
    impact_g: float = _rule(
        2.0,
        "g",
        "Something hit the vehicle if its specific force exceeds the possible thrust by more than this.",
    )
    free_height_m: float = _rule(
        0.3, "m", "A vehicle more than this above the lowest place of its log flies freely."
    )
    still_m: float = _rule(0.02, "m", "A vehicle that moves less than this in 0.3 s is still.")
    resting_thrust_g: float = _rule(
        0.3, "g", "A still vehicle with less specific thrust than this rests on the floor."
    )
    sparse_rate_hz: float = _rule(
        20.0, "Hz", "Median rate below which a topic is not checked for rate drops."
    )
    rate_drop_share: float = _rule(
        0.5, "1", "A topic is reported if its rate in its worst second is below this share of the median."
    )

    # Description of a disturbance outside the library.
    min_skill: float = _rule(0.1, "1", "Held-out skill below which a dependence is not reported.")
    clear_form_skill: float = _rule(
        0.5, "1", "Held-out skill above which a closed form of the force is reported."
    )
    form_skill_margin: float = _rule(
        0.05, "1", "A simpler closed form is preferred if its skill is at most this far below the best."
    )
    leading_share: float = _rule(
        0.35, "1", "A slope is reported if its contribution is at least this share of the strongest one."
    )
    shown_slack_m: float = _rule(0.1, "m", "Free length of a tether above which the description mentions it.")
    one_heading: float = _rule(
        0.995, "1", "Mean resultant length of the heading above which all flights had one heading."
    )

    # Rotor speeds.
    rotor_speed_sigma: float = _rule(
        0.002, "1", "Least error of a rotor's speed squared, over that at the greatest thrust, in a bin."
    )
    rotor_scale_sigma: float = _rule(
        0.02,
        "1",
        "Error of a rotor's speed squared at the greatest thrust: a factor for each flight.",
    )
    rotor_age_sigma_s: float = _rule(
        0.01, "s", "Age of rotor speeds at their stamps: motor controllers report means, and late."
    )

    # Comparison of hovers.
    hover_block_s: float = _rule(2.0, "s", "Length of the blocks whose scatter gives the error of a mean.")
    hover_margin_s: float = _rule(
        0.5, "s", "Time after take-off, before landing and around gaps that the mean leaves out."
    )
    hover_min_s: float = _rule(4.0, "s", "Least time in the air of a log.")
    hover_floor: float = _rule(
        0.003, "1", "Error of the mean balance, over the weight, that no scatter shows."
    )
    hover_scatters: tuple[float, ...] = _rule(
        (0.25, 0.5, 1.0),
        "1",
        "Factors, equally probable, on the error of a mean that the blocks show. Flights of one "
        "programme have much of their scatter in common.",
    )
    hover_handling: tuple[float, ...] = _rule(
        (0.1, 0.3, 1.0),
        "1",
        "Factors, equally probable, on the tolerances of the vehicle file and on `rotor_tilt_sigma_rad`: "
        "how much the build changed when the vehicle was handled.",
    )
    change_odds_against: float = _rule(
        10.0,
        "1",
        "Prior odds against each cause in a comparison of hovers. They are lower than those of a trace, "
        "since the flights were compared for a reason.",
    )
    hover_thrust_sigmas: tuple[float, ...] = _rule(
        (0.005, 0.01, 0.02, 0.05),
        "1",
        "Standard deviations, equally probable, of the thrust scale from log to log: battery, "
        "temperature, propellers. The scatter of the baseline weighs them.",
    )
    rotor_tilt_sigma_rad: float = _rule(
        math.radians(2.0),
        "rad",
        "By how much the axis of a rotor tilts each time that the vehicle is handled. The rotor "
        "then turns the vehicle in yaw, and flights cannot tell why.",
    )
    thrust_curve_linear: tuple[float, ...] = _rule(
        (0.4, 0.6, 0.8, 1.0),
        "1",
        "Linear shares of an unknown thrust curve, equally probable.",
    )

    @property
    def tie_nats(self) -> float:
        """Difference of log evidence, in nats, below which two sets count as equally good."""
        return math.log(self.odds)

    @property
    def alias_probability(self) -> float:
        """Probability above which an alternative is not excluded."""
        return 1.0 / self.odds

    @property
    def undecided_sigma(self) -> float:
        """Separation, in sigma, that leaves an alias a probability of 1/odds."""
        return math.sqrt(2.0 * math.log(self.odds))

    @property
    def prior_log_odds(self) -> float:
        """Prior log odds of each effect."""
        return math.log(1.0 / self.prior_odds_against)


RULES = Rules()
"""The rules in force."""


class RuleRow(NamedTuple):
    """One row of the table: name, value, unit, meaning, and where the value comes from."""

    name: str
    value: float | tuple[float, ...]
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
