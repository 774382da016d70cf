"""Parameter dumps of PX4 and ArduPilot: rotor order, positions, spins, curve; any other bytes, one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from trimtab.host.base.errors import UsageError
from trimtab.host.vehicle.dumps import (
    ARDUPILOT_QUADS,
    HOVER_DEFAULTS,
    LARGEST_BYTES,
    Dump,
    parse_dump,
    read_dump,
)

PX4 = {
    "CA_AIRFRAME": 0,
    "CA_ROTOR_COUNT": 4,
    "CA_ROTOR0_PX": 0.13,
    "CA_ROTOR0_PY": 0.22,
    "CA_ROTOR0_KM": 0.05,
    "CA_ROTOR1_PX": -0.13,
    "CA_ROTOR1_PY": -0.2,
    "CA_ROTOR1_KM": 0.05,
    "CA_ROTOR2_PX": 0.13,
    "CA_ROTOR2_PY": -0.22,
    "CA_ROTOR2_KM": -0.05,
    "CA_ROTOR3_PX": -0.13,
    "CA_ROTOR3_PY": 0.2,
    "CA_ROTOR3_KM": -0.05,
    "MPC_THR_HOVER": 0.4,
    "THR_MDL_FAC": 0.3,
}
ARDUPILOT = {
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 1,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.22,
    "MOT_PWM_MIN": 1000,
    "MOT_PWM_MAX": 2000,
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
}


def qgc(values: dict[str, float]) -> bytes:
    """The rows that QGroundControl writes."""
    head = "# Onboard parameters for Vehicle 1\n#\n# Vehicle-Id Component-Id Name Value Type\n"
    return (head + "".join(f"1\t1\t{name}\t{value}\t9\n" for name, value in values.items())).encode()


def planner(values: dict[str, float]) -> bytes:
    """The rows that Mission Planner writes."""
    return "".join(f"{name},{value}\r\n" for name, value in values.items()).encode()


def proxy(values: dict[str, float]) -> bytes:
    """The rows that MAVProxy writes."""
    return "".join(f"{name:16} {value:f}\n" for name, value in values.items()).encode()


def places(dump: Dump) -> list[tuple[int, int, str]]:
    """Sides, forward and right, and spin of each rotor."""

    def side(x: float) -> int:
        return 0 if abs(x) < 1e-9 else round(math.copysign(1.0, x))

    return [(side(r.position_m[0]), side(r.position_m[1]), r.spin) for r in dump.rotors]


def refusal(data: bytes) -> str:
    with pytest.raises(UsageError) as caught:
        parse_dump(data, "dump")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("dump")
    return str(caught.value)


def test_px4_dump_gives_positions_spins_curve_and_hover() -> None:
    dump = parse_dump(qgc(PX4), "dump")
    assert places(dump) == [(1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw"), (-1, 1, "cw")]
    assert dump.rotors[1].position_m == (-0.13, -0.2, 0.0)
    assert dump.has_size
    assert dump.thrust_curve == (0.7, 0.3)
    assert dump.hover_share == 0.4
    scaled = dump.with_arm(0.1)
    assert sum(math.hypot(*r.position_m[:2]) for r in scaled) / 4 == pytest.approx(0.1)
    assert scaled[1].position_m[1] / scaled[1].position_m[0] == pytest.approx(0.2 / 0.13)


@pytest.mark.parametrize("write", [qgc, planner, proxy])
def test_ardupilot_dump_is_read_in_every_form(write: Callable[[dict[str, float]], bytes]) -> None:
    dump = parse_dump(write(ARDUPILOT), "dump")
    assert places(dump) == [(1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw"), (-1, 1, "cw")]
    assert not dump.has_size
    assert dump.thrust_curve == (0.35, 0.65)
    assert dump.hover_share == pytest.approx(0.22)
    assert dump.pwm_us == pytest.approx((1150.0, 1950.0))


# Motor 1 to 4 as ArduPilot's documentation draws them.
@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (0, [(0, 1, "ccw"), (0, -1, "ccw"), (1, 0, "cw"), (-1, 0, "cw")]),
        (3, [(1, 1, "cw"), (-1, -1, "cw"), (1, -1, "ccw"), (-1, 1, "ccw")]),
        (12, [(-1, 1, "cw"), (1, 1, "ccw"), (-1, -1, "ccw"), (1, -1, "cw")]),
        (13, [(1, 1, "ccw"), (1, -1, "cw"), (-1, -1, "ccw"), (-1, 1, "cw")]),
        (14, [(1, 1, "ccw"), (-1, 1, "cw"), (-1, -1, "ccw"), (1, -1, "cw")]),
        (18, [(-1, 1, "ccw"), (1, 1, "cw"), (-1, -1, "cw"), (1, -1, "ccw")]),
    ],
)
def test_ardupilot_frame_has_its_order_and_spins(shape: int, expected: list[tuple[int, int, str]]) -> None:
    assert places(parse_dump(planner({**ARDUPILOT, "FRAME_TYPE": shape}), "dump")) == expected


def test_neighbours_turn_against_each_other_in_every_frame() -> None:
    for _, angles, spins in ARDUPILOT_QUADS.values():
        around = [spin for _, spin in sorted(zip(angles, spins, strict=True))]
        assert around in (["cw", "ccw", "cw", "ccw"], ["ccw", "cw", "ccw", "cw"])


def test_default_hover_thrust_counts_as_unknown() -> None:
    for values in (PX4, ARDUPILOT):
        defaults = {name: value for name, value in HOVER_DEFAULTS.items() if name in values}
        assert parse_dump(qgc({**values, **defaults}), "dump").hover_share is None
    without = {name: value for name, value in PX4.items() if name not in ("MPC_THR_HOVER", "THR_MDL_FAC")}
    dump = parse_dump(qgc(without), "dump")
    assert dump.hover_share is None
    assert dump.thrust_curve is None
    assert parse_dump(planner({**ARDUPILOT, "MOT_PWM_MIN": 0, "MOT_PWM_MAX": 0}), "dump").pwm_us is None


@pytest.mark.parametrize(
    "changes",
    [
        {"CA_ROTOR_COUNT": 6},
        {"CA_AIRFRAME": 2},
        {"CA_ROTOR2_KM": 0},
        {"CA_ROTOR1_AX": 0.3},
        {"CA_ROTOR1_AZ": 1.0},
        {"CA_ROTOR0_PX": 0, "CA_ROTOR0_PY": 0},
        {"CA_ROTOR0_PX": 900},
        {"THR_MDL_FAC": 1.5},
        {"MPC_THR_HOVER": 0.0},
    ],
)
def test_px4_dump_of_no_level_quadrotor_is_refused(changes: dict[str, float]) -> None:
    assert next(iter(changes)).split("_")[0] in refusal(qgc({**PX4, **changes}))


@pytest.mark.parametrize(
    "changes",
    [
        {"FRAME_CLASS": 2},
        {"FRAME_TYPE": 4},
        {"FRAME_TYPE": 1.5},
        {"MOT_THST_EXPO": -0.4},
        {"MOT_THST_HOVER": 2},
        {"MOT_PWM_MIN": 2100},
        {"MOT_SPIN_MIN": 0.99},
    ],
)
def test_ardupilot_dump_of_no_known_quadrotor_is_refused(changes: dict[str, float]) -> None:
    refusal(planner({**ARDUPILOT, **changes}))


@pytest.mark.parametrize("missing", ["CA_ROTOR3_PX", "CA_ROTOR0_KM"])
def test_missing_parameter_is_named(missing: str) -> None:
    assert missing in refusal(qgc({name: value for name, value in PX4.items() if name != missing}))


@pytest.mark.parametrize(
    ("data", "where"),
    [
        (b"", "dump:"),
        (b"\xff\xfe", "byte 0"),
        (b"SOME,1\n", "1 parameters"),
        (b"FRAME_CLASS,1\nFRAME_TYPE\n", "dump:2"),
        (b"FRAME_CLASS,one\n", "dump:1"),
        (b"FRAME_CLASS,nan\n", "dump:1"),
        (b"FRAME_CLASS,1e999\n", "dump:1"),
        (b"FRAME_CLASS,1\nFRAME_CLASS,2\n", "dump:2"),
        (b"#" * (LARGEST_BYTES + 1), "bytes"),
    ],
)
def test_file_that_is_no_dump_is_refused_with_its_place(data: bytes, where: str) -> None:
    assert where in refusal(data)


def test_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "missing.params"):
        with pytest.raises(UsageError):
            read_dump(path)


def read_or_refused(data: bytes) -> None:
    try:
        dump = parse_dump(data, "dump")
    except UsageError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert len(dump.rotors) == 4
        assert dump.thrust_curve is None or sum(dump.thrust_curve) == pytest.approx(1.0)


@settings(max_examples=500)
@given(st.binary(max_size=300))
@example(b"FRAME_CLASS,1\rFRAME_TYPE,1")
@example(b"CA_ROTOR_COUNT,4")
def test_any_bytes_are_read_or_refused_in_one_line(data: bytes) -> None:
    read_or_refused(data)


value = st.one_of(
    st.floats(), st.integers(-20, 20), st.text(max_size=5), st.sampled_from(["1_0", "0x1", "-0"])
)


@settings(max_examples=500)
@given(
    base=st.sampled_from([PX4, ARDUPILOT]),
    changes=st.dictionaries(
        st.sampled_from([*PX4, *ARDUPILOT, "CA_ROTOR0_AX", "CA_ROTOR1_PZ"]), value, max_size=4
    ),
    write=st.sampled_from(["{},{}\n", "1\t1\t{}\t{}\t9\n", "{} {}\n"]),
    cut=st.integers(0, 400),
)
def test_any_values_are_read_or_refused_in_one_line(
    base: dict[str, float], changes: dict[str, object], write: str, cut: int
) -> None:
    text = "".join(write.format(name, each) for name, each in {**base, **changes}.items())
    read_or_refused(text.encode("utf-8", "surrogatepass"))
    read_or_refused(text.encode("utf-8", "surrogatepass")[:cut])
