"""The radio channel: its statistics are those of its settings, its slots half-duplex, its chance seeded."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from trimtab.firmware_model.clock import NEVER_US
from trimtab.sitl.air_time import air_us
from trimtab.sitl.radio import BurstLoss, RadioChannel
from trimtab.sitl.world import RadioSettings

FRAME = bytes(range(116))
CLEAN = RadioSettings(loss=0.0, duplicate=0.0, corrupt=0.0, jitter_us=0)


class Endless:
    """A radio that always has a frame, up to a limit, and keeps what it receives."""

    def __init__(self, frames: int, frame: bytes = FRAME) -> None:
        self.left = frames
        self.frame = frame
        self.sent_us: list[int] = []
        self.received: list[tuple[int, bytes]] = []
        self.pose_waits = False

    @property
    def has_frame(self) -> bool:
        return self.left > 0

    def air_send(self, now_us: int) -> bytes | None:
        if not self.left:
            return None
        self.left -= 1
        self.sent_us.append(now_us)
        return self.frame

    def air_receive(self, frame: bytes, now_us: int) -> None:
        self.received.append((now_us, frame))


class Numbered(Endless):
    """A radio whose frames say how many came before."""

    def air_send(self, now_us: int) -> bytes | None:
        frame = super().air_send(now_us)
        return None if frame is None else (len(self.sent_us) - 1).to_bytes(2, "big")


def fly(
    settings: RadioSettings, up: int, down: int, *, frame: bytes = FRAME, seed: int = 0, until_us: int = 10**9
) -> tuple[RadioChannel, Endless, Endless]:
    ground, vehicle = Endless(up, frame), Endless(down, frame)
    rngs = [np.random.default_rng((seed, k)) for k in range(2)]
    channel = RadioChannel(
        ground=ground, vehicle=vehicle, settings=settings, up_rng=rngs[0], down_rng=rngs[1]
    )
    now_us = 0
    while channel.due_us < min(NEVER_US, until_us):
        now_us = -(-channel.due_us // 1000) * 1000
        channel.tick(now_us)
    return channel, ground, vehicle


def uniforms(seed: int) -> Iterator[float]:
    rng = np.random.default_rng(seed)
    while True:
        yield from rng.random(4096).tolist()


@pytest.mark.parametrize(("loss", "burst"), [(0.01, 5.0), (0.1, 5.0), (0.3, 20.0), (0.1, 1.0), (0.8, 4.0)])
def test_burst_loss_has_the_share_and_burst_length_set(loss: float, burst: float) -> None:
    chain = BurstLoss(loss, burst, 0.5, uniforms(3).__next__)
    lost = np.array([chain.lost(116) for _ in range(400_000)])
    starts = np.count_nonzero(lost[1:] & ~lost[:-1])
    assert lost.mean() == pytest.approx(loss, rel=0.1)
    assert lost.sum() / starts == pytest.approx(burst, rel=0.1)


def test_short_frames_are_lost_less_often_than_full_ones() -> None:
    shares = []
    for size in (116, 20):
        chain = BurstLoss(0.2, 5.0, 0.5, uniforms(4).__next__)
        shares.append(np.mean([chain.lost(size) for _ in range(50_000)]))
    assert 0.5 * shares[0] < shares[1] < 0.8 * shares[0]


def test_channel_duplicates_and_damages_as_set() -> None:
    settings = RadioSettings(loss=0.0, duplicate=0.05, corrupt=0.1)
    channel, _, vehicle = fly(settings, up=20_000, down=0)
    damaged = sum(frame != FRAME for _, frame in vehicle.received)
    assert channel.up.duplicated == pytest.approx(1000, rel=0.15)
    assert channel.up.corrupted == pytest.approx(2000, rel=0.15)
    assert len(vehicle.received) == 20_000 + channel.up.duplicated
    assert damaged == pytest.approx(2100, rel=0.15)


def test_channel_delays_by_slot_latency_and_jitter() -> None:
    settings = CLEAN.model_copy(update={"latency_us": 3000, "jitter_us": 1500})
    _, ground, vehicle = fly(settings, up=5000, down=0)
    delays = np.array([r - s for s, (r, _) in zip(ground.sent_us, vehicle.received, strict=True)])
    assert delays.min() == 5000
    assert delays.max() == 7000  # the tick after 6500
    assert np.mean(delays == 6000) == pytest.approx(2 / 3, abs=0.03)  # 5000 to 6500 us, at the next tick


@pytest.mark.parametrize(("bit_rate", "full_ms"), [(850_000, 1.71), (6_800_000, 0.34)])
def test_frame_is_in_the_air_as_long_as_transceivers_take(bit_rate: int, full_ms: float) -> None:
    assert air_us(116, bit_rate) / 1000 == pytest.approx(full_ms, abs=0.005)
    settings = CLEAN.model_copy(update={"bit_rate": bit_rate, "latency_us": 500})
    _, ground, vehicle = fly(settings, up=50, down=0)
    (delay,) = {r - s for s, (r, _) in zip(ground.sent_us, vehicle.received, strict=True)}
    assert delay == {850_000: 3000, 6_800_000: 1000}[bit_rate]  # 2.21 and 0.84 ms, at the next tick
    short = [air_us(size, bit_rate) for size in range(117)]
    assert short == sorted(short)


def test_short_frames_are_lost_as_set() -> None:
    for risk in (0.0, 1.0):
        chain = BurstLoss(0.2, 5.0, risk, uniforms(4).__next__)
        lost = np.mean([chain.lost(0) for _ in range(50_000)])
        assert lost == pytest.approx(0.2 * risk, rel=0.1)


def test_jitter_beyond_a_slot_lets_frames_overtake() -> None:
    settings = CLEAN.model_copy(update={"jitter_us": 8000})
    ground, vehicle = Numbered(400), Endless(0)
    rngs = [np.random.default_rng((0, k)) for k in range(2)]
    channel = RadioChannel(
        ground=ground, vehicle=vehicle, settings=settings, up_rng=rngs[0], down_rng=rngs[1]
    )
    for now_us in range(0, 1_000_000, 1000):
        channel.tick(now_us)
    arrived = [int.from_bytes(frame, "big") for _, frame in vehicle.received]
    assert sorted(arrived) == list(range(400))
    late = np.array(arrived) - np.maximum.accumulate(arrived)
    assert np.count_nonzero(late < 0) > 40
    assert late.min() >= -4  # 8 ms are four slots


def test_two_eager_radios_share_the_slots_evenly() -> None:
    _, ground, vehicle = fly(CLEAN, up=500, down=500)
    times = sorted(ground.sent_us + vehicle.sent_us)
    assert min(np.diff(times)) == 2000
    assert ground.sent_us[:3] == [0, 4000, 8000]
    assert vehicle.sent_us[:3] == [2000, 6000, 10_000]


def test_pose_takes_the_next_slot_and_the_other_side_keeps_its_turn() -> None:
    ground, vehicle = Endless(50), Endless(50)
    rngs = [np.random.default_rng((0, k)) for k in range(2)]
    channel = RadioChannel(ground=ground, vehicle=vehicle, settings=CLEAN, up_rng=rngs[0], down_rng=rngs[1])
    for now_us in range(0, 12_000, 1000):
        ground.pose_waits = now_us == 2000
        channel.tick(now_us)
    assert ground.sent_us == [0, 2000, 6000, 10_000]
    assert vehicle.sent_us == [4000, 8000]


def test_poses_without_end_leave_every_third_slot_to_the_other_side() -> None:
    ground, vehicle = Endless(200), Endless(200)
    ground.pose_waits = True
    rngs = [np.random.default_rng((0, k)) for k in range(2)]
    channel = RadioChannel(ground=ground, vehicle=vehicle, settings=CLEAN, up_rng=rngs[0], down_rng=rngs[1])
    for now_us in range(0, 120_000, 1000):
        channel.tick(now_us)
    assert (len(ground.sent_us), len(vehicle.sent_us)) == (40, 20)
    assert max(np.diff(vehicle.sent_us)) == 6000


@pytest.mark.parametrize(("again_us", "first"), [(5000, "vehicle"), (9000, "ground")])
def test_pose_goes_ahead_again_after_an_idle_slot(again_us: int, first: str) -> None:
    """The ground sends at 2 ms and, out of turn, at 4 ms; then both have a frame, at once or later."""
    ground, vehicle = Endless(0), Endless(0)
    rngs = [np.random.default_rng((0, k)) for k in range(2)]
    channel = RadioChannel(ground=ground, vehicle=vehicle, settings=CLEAN, up_rng=rngs[0], down_rng=rngs[1])
    for now_us in range(0, 16_000, 1000):
        channel.tick(now_us)
        ground.pose_waits = ground.left > 0
        if now_us in (1000, 3000, again_us):
            ground.left, ground.pose_waits = 1, True
            channel.wake(now_us, ground=True)
        if now_us == again_us:
            vehicle.left = 1
            channel.wake(now_us, ground=False)
    assert ground.sent_us[:2] == [2000, 4000]
    assert (ground.sent_us[2] < vehicle.sent_us[0]) == (first == "ground")


def test_idle_side_leaves_every_slot_to_the_other() -> None:
    _, ground, _ = fly(CLEAN, up=100, down=0)
    assert ground.sent_us == [2000 * k for k in range(100)]


def test_cut_lets_nothing_pass_either_way() -> None:
    settings = CLEAN.model_copy(update={"cuts_s": ((1.0, 0.5),)})
    channel, ground, vehicle = fly(settings, up=1000, down=1000)
    for sender, receiver in ((ground, vehicle), (vehicle, ground)):
        during = sum(1_000_000 <= t < 1_500_000 for t in sender.sent_us)
        assert len(receiver.received) == 1000 - during
    assert channel.up.cut + channel.down.cut == 250


def test_sleeping_channel_wakes_when_a_radio_has_something() -> None:
    channel, ground, vehicle = fly(CLEAN, up=1, down=0)
    assert channel.due_us == NEVER_US
    ground.left = 1
    channel.wake(500_300, ground=True)
    assert channel.due_us == 500_300
    channel.tick(501_000)
    assert ground.sent_us[-1] == 501_000
    assert len(vehicle.received) == 1


def test_same_seed_gives_the_same_deliveries_and_another_does_not() -> None:
    settings = RadioSettings(loss=0.2, corrupt=0.05, duplicate=0.05)
    runs = [fly(settings, up=2000, down=2000, seed=seed)[2].received for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]
