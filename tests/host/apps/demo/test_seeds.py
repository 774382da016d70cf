"""The two seeds of a demo."""

from __future__ import annotations

from trimtab.host.apps.demo.seeds import host_seed, world_seed


def test_seeds_of_a_demo_differ_and_never_hold_its_own() -> None:
    for seed in (0, 1, 20261121, 2**40):
        assert len({seed, host_seed(seed), world_seed(seed)}) == 3


def test_seeds_stay_what_they_are() -> None:
    # The first bytes of SHA-256 over the texts in the module: part of what a seed means.
    assert host_seed(1) == 2358227596
    assert world_seed(1) == 9144571323868964709


def test_seeds_fit_where_they_go() -> None:
    assert all(0 <= host_seed(seed) < 2**32 for seed in range(200))
    assert all(0 <= world_seed(seed) < 2**63 for seed in range(200))
    assert len({world_seed(seed) for seed in range(200)}) == 200
