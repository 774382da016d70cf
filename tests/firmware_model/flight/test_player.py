"""The player: which piece is in the engine when, and when it wants to be asked again."""

from array import array

import pytest

from trimtab.firmware_model.clock import NEVER_US
from trimtab.firmware_model.flight.player import Player
from trimtab.firmware_model.flight.track import track


def node(x):
    return (x, *(0.0,) * 11)


@pytest.fixture
def player():
    return Player(memoryview(array("d", bytes(8 * 25))), memoryview(array("d", bytes(8 * 5))))


@pytest.fixture
def pieces():
    nodes = [(0, node(0.0)), (2_500, node(1.0)), (4_000, node(2.0)), (10_000, node(3.0))]
    return track(nodes, [(0, 0.0, 0.0), (3_000, 1.0, 0.0)])


def walk(player, start_us, count):
    """(time, piece's first number, time inside, yaw, time inside) at each tick, until the track ends."""
    rows = []
    for now_us in range(start_us, start_us + 1_000 * count, 1_000):
        if now_us >= player.switch_us and player.switch(now_us):
            return rows, now_us
        piece_us, yaw_us = now_us - player.piece_us, now_us - player.yaw_us
        rows.append((now_us - start_us, player.piece[1], piece_us, player.yaw[1], yaw_us))
    return rows, None


def test_player_switches_at_the_first_tick_of_a_piece_and_ends_at_the_end(player, pieces):
    player.start(pieces, 7_000)
    rows, ended = walk(player, 7_000, 20)
    assert ended == 17_000
    assert rows[:6] == [
        (0, 0.0, 0, 0.0, 0),
        (1_000, 0.0, 1_000, 0.0, 1_000),
        (2_000, 0.0, 2_000, 0.0, 2_000),
        (3_000, 1.0, 500, 1.0, 0),
        (4_000, 2.0, 0, 1.0, 1_000),
        (5_000, 2.0, 1_000, 1.0, 2_000),
    ]
    assert player.switch_us == NEVER_US


def test_player_late_skips_pieces_it_missed(player, pieces):
    player.start(pieces, 0)
    assert not player.switch(6_000)
    assert (player.piece[1], player.piece_us) == (2.0, 4_000)
    assert player.switch(99_000)


def test_player_at_rest_never_ends(player, pieces):
    player.hold_first_piece(pieces, 1_000)
    assert player.switch_us == NEVER_US
    assert player.piece[1] == 0.0


def test_player_without_a_track_has_ended(player):
    assert player.switch(0)
