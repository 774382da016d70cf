"""Running sums and the field encodings of telemetry."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trimtab.protocol import messages as m
from trimtab.protocol import telemetry
from trimtab.protocol.codec import Codec
from trimtab.protocol.telemetry import ControlInterval, IntervalDecoder, unwrap_tick


class Vehicle:
    """Adds up the same drawn signals as doubles, and keeps every tick's values as the oracle."""

    def __init__(self, seed: int, start: float = 0.0) -> None:
        self.rng = random.Random(seed)
        self.ticks: list[tuple[float, ...]] = []
        self.sums = [start] * 10

    def run(self, ticks: int) -> m.FcControl:
        scales = [telemetry.MOTOR_COUNTS] * 4 + [telemetry.GYRO_COUNTS] * 3 + [telemetry.FORCE_COUNTS] * 3
        for _ in range(ticks):
            row = (
                *(self.rng.random() for _ in range(4)),
                *(self.rng.uniform(-20, 20) for _ in range(3)),
                *(self.rng.uniform(-60, 60) for _ in range(3)),
            )
            self.ticks.append(row)
            self.sums = [total + scale * x for total, scale, x in zip(self.sums, scales, row, strict=True)]
        return telemetry.control_message(
            len(self.ticks),
            collective_n=7.0,
            rate_cmd=(0.1, 0.2, 0.3),
            torque=(0.0, 0.0, 0.0),
            motor_sum=self.sums[:4],
            gyro_sum=self.sums[4:7],
            force_sum=self.sums[7:],
            rate_integral=(0.0, 0.0, 0.0),
        )

    def means(self, start: int, end: int) -> list[float]:
        return [math.fsum(column) / (end - start) for column in zip(*self.ticks[start:end], strict=True)]


def check(vehicle: Vehicle, interval: ControlInterval) -> None:
    """The means are off by less than one count over the interval."""
    ticks = interval.end_tick - interval.start_tick
    means = vehicle.means(interval.start_tick, interval.end_tick)
    found = (*interval.motor_mean, *interval.gyro_mean, *interval.force_mean)
    steps = (
        [1 / telemetry.MOTOR_COUNTS] * 4 + [1 / telemetry.GYRO_COUNTS] * 3 + [1 / telemetry.FORCE_COUNTS] * 3
    )
    for expected, value, step in zip(means, found, steps, strict=True):
        assert abs(expected - value) <= 1.001 * step / ticks


@pytest.mark.parametrize("start", [0.0, 2.0**32 - 1000.0, -(2.0**31)])
def test_intervals_give_the_means_of_the_ticks_between_also_across_the_wrap(start: float) -> None:
    vehicle, decoder = Vehicle(1, start), IntervalDecoder()
    assert decoder.push(vehicle.run(10)) is None
    for ticks in (10, 10, 1, 500, 9_000):
        interval = decoder.push(vehicle.run(ticks))
        assert interval is not None
        assert interval.end_tick - interval.start_tick == ticks
        check(vehicle, interval)
    assert decoder.invalid == 0


def test_a_lost_message_widens_the_interval_and_loses_nothing() -> None:
    vehicle, decoder = Vehicle(2), IntervalDecoder()
    decoder.push(vehicle.run(10))
    vehicle.run(10)
    vehicle.run(10)
    interval = decoder.push(vehicle.run(10))
    assert interval is not None
    assert (interval.start_tick, interval.end_tick) == (10, 40)
    check(vehicle, interval)


def test_sums_of_the_intervals_add_up_without_drift() -> None:
    vehicle, decoder = Vehicle(3), IntervalDecoder()
    decoder.push(vehicle.run(10))
    total = 0.0
    for _ in range(200):
        interval = decoder.push(vehicle.run(10))
        assert interval is not None
        total += 10 * interval.gyro_mean[0]
    assert abs(total - 2000 * vehicle.means(10, 2010)[4]) <= 1.001 / telemetry.GYRO_COUNTS


def test_a_gap_over_ten_seconds_or_a_tick_running_back_begins_anew() -> None:
    vehicle, decoder = Vehicle(4), IntervalDecoder()
    decoder.push(vehicle.run(10))
    assert decoder.push(vehicle.run(10_001)) is None
    assert decoder.invalid == 1
    assert decoder.push(vehicle.run(10)) is not None
    rebooted = Vehicle(5)
    assert decoder.push(rebooted.run(5)) is None
    assert decoder.invalid == 2
    interval = decoder.push(rebooted.run(10))
    assert interval is not None
    check(rebooted, interval)


def test_repeated_and_late_messages_are_ignored() -> None:
    vehicle, decoder = Vehicle(6), IntervalDecoder()
    first, late, third = vehicle.run(10), vehicle.run(10), vehicle.run(10)
    decoder.push(first)
    assert decoder.push(third) is not None
    assert decoder.push(late) is None
    assert decoder.push(third) is None
    assert decoder.ignored == 2
    interval = decoder.push(vehicle.run(10))
    assert interval is not None
    assert (interval.start_tick, interval.end_tick) == (30, 40)


def test_a_message_overtaken_by_several_is_late_and_no_reboot() -> None:
    vehicle, decoder = Vehicle(7), IntervalDecoder()
    messages = [vehicle.run(10) for _ in range(120)]
    for message in (messages[0], *messages[3:100]):
        decoder.push(message)
    for late in (1, 2, 5, 50, 98):
        assert decoder.push(messages[late]) is None
    assert (decoder.ignored, decoder.invalid) == (5, 0)
    interval = decoder.push(messages[100])
    assert interval is not None
    assert (interval.start_tick, interval.end_tick) == (1000, 1010)
    check(vehicle, interval)


def test_a_late_message_from_within_a_long_gap_is_ignored() -> None:
    vehicle, decoder = Vehicle(8), IntervalDecoder()
    first, late, last = vehicle.run(10), vehicle.run(10), vehicle.run(5_000)
    decoder.push(first)
    assert decoder.push(last) is not None
    assert decoder.push(late) is None
    assert (decoder.ignored, decoder.invalid) == (1, 0)


@given(a=st.integers(0, 2**32 - 1), d=st.integers(-(2**31), 2**31 - 1))
def test_difference_is_exact_below_half_the_modulus(a: int, d: int) -> None:
    assert telemetry.difference((a + d) % 2**32, a) == d


@given(total=st.floats(-1e12, 1e12))
def test_encode_sum_is_the_floor_modulo_two_to_the_32(total: float) -> None:
    assert telemetry.encode_sums([total]) == [math.floor(total) % 2**32]


@given(parts=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(x * x for x in q) > 1e-3))
def test_quaternion_error_is_at_most_half_a_step(parts) -> None:
    norm = math.sqrt(sum(x * x for x in parts))
    q = [x / norm for x in parts]
    sent = telemetry.encode_quaternion(q)
    assert all(abs(a / 32767 - b) <= 0.5 / 32767 + 1e-15 for a, b in zip(sent, q, strict=True))
    back = telemetry.decode_quaternion(sent)
    assert abs(math.hypot(*back) - 1.0) < 1e-12
    assert 2 * math.acos(min(1.0, abs(sum(a * b for a, b in zip(back, q, strict=True))))) < 1e-4


@given(age_us=st.integers(0, 6_553_000))
def test_age_error_is_at_most_half_a_step(age_us: int) -> None:
    back = telemetry.decode_age(telemetry.encode_age(age_us))
    assert back is not None
    assert abs(back - age_us) <= 50


@pytest.mark.parametrize("age_us", [None, 6_553_500, 10**12])
def test_age_beyond_the_field_or_absent_reads_as_none(age_us: int | None) -> None:
    assert telemetry.decode_age(telemetry.encode_age(age_us)) is None


def test_estimate_survives_the_wire() -> None:
    message = telemetry.estimate_message(
        123,
        p_ned=(1.0, -2.0, -3.5),
        v_ned=(0.5, 0.25, 0.0),
        q_ned_frd=(1.0, 0.0, 0.0, 0.0),
        rate_frd=(0.0, 1.0, 2.0),
        mocap_age_us=7_300,
        gyro_bias_frd=(0.0, 0.0, 0.125),
    )
    (back,) = Codec(*m.HOST).decode(Codec(*m.VEHICLE).encode(message))
    assert isinstance(back, m.FcEstimate)
    assert back.tick == 123
    assert back.p == (1.0, -2.0, -3.5)
    assert telemetry.decode_quaternion(back.q) == (1.0, 0.0, 0.0, 0.0)
    assert telemetry.decode_age(back.mocap_age) == 7_300
    assert back.gyro_bias == (0.0, 0.0, 0.125)


def test_rotor_speeds_survive_the_wire_within_half_a_step() -> None:
    speeds = (0.0, 0.476807, 1.0, 2.0)
    message = telemetry.rotors_message(2**32 + 7, speed=speeds)
    (back,) = Codec(*m.HOST).decode(Codec(*m.VEHICLE).encode(message))
    assert isinstance(back, m.FcRotors)
    assert back.tick == 7
    read = telemetry.decode_rotor_speed(back.speed)
    assert read[:3] == pytest.approx(speeds[:3], abs=0.5 / telemetry.ROTOR_COUNTS)
    assert read[3] == 65535 / telemetry.ROTOR_COUNTS  # the end of the code


@pytest.mark.parametrize("speed", [math.nan, math.inf])
def test_rotor_speed_that_is_not_finite_is_not_sent(speed: float) -> None:
    with pytest.raises((ValueError, OverflowError)):
        telemetry.rotors_message(1, speed=(0.5, speed, 0.5, 0.5))


@pytest.mark.parametrize("now", [0, 5, 2**31, 2**32 - 1, 2**32, 3 * 2**32 + 7])
@pytest.mark.parametrize("ahead", [-3, 0, 4000, 2**31 - 1])
def test_whole_tick_is_the_nearest_with_those_bits(now, ahead):
    assert unwrap_tick((now + ahead) % 2**32, now) == now + ahead
