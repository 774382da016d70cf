"""The dialect against MAVLink's own definitions, its room on the air, and what is generated from it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from trimtab.protocol import generate
from trimtab.protocol import messages as m
from trimtab.protocol.codec import Codec
from trimtab.protocol.generated.frames import DIALECT_VERSION, MESSAGES
from trimtab.protocol.messages import mavlink
from trimtab.protocol.uwb_pieces import FRAME_BYTES

OVERHEAD = 12
STANDARD = sorted(number for number in MESSAGES if number < 52100)
UNSENT = {"ATT_POS_MOCAP": 84, "VISION_POSITION_ESTIMATE": 85}
NEWER = {"SERIAL_CONTROL": ["target_system", "target_component"]}
"""Extension fields (uint8_t) that MAVSDK sends and the installed pymavlink does not know yet."""
SPLIT = {"FILE_TRANSFER_PROTOCOL", "ODOMETRY"}
"""Standard messages that need several frames."""
"""Bytes of fields at the end that are never sent: the pose covariance."""


@pytest.mark.parametrize("number", STANDARD)
def test_standard_message_equals_common_bit_for_bit(number: int) -> None:
    from pymavlink.dialects.v20 import common

    ours, theirs = mavlink.mavlink_map[number], common.mavlink_map[number]
    assert ours.crc_extra == theirs.crc_extra
    assert ours.msgname == theirs.msgname
    newer = NEWER.get(ours.msgname, [])
    assert ours.fieldnames == theirs.fieldnames + newer
    for attribute in ("fieldtypes", "ordered_fieldnames", "array_lengths", "orders"):
        assert getattr(ours, attribute)[: len(theirs.fieldnames)] == getattr(theirs, attribute)
    assert ours.unpacker.format == theirs.unpacker.format + "B" * len(newer)


def test_standard_constants_equal_common() -> None:
    from pymavlink.dialects.v20 import common

    names = [name for name in vars(mavlink) if name.startswith("MAV_") and not name.endswith("_END")]
    assert len(names) > 40
    for name in names:
        assert getattr(mavlink, name) == getattr(common, name), name


def test_dialect_has_every_constant_that_mavutil_names() -> None:
    """mavutil can thus load it in place of common: it reads most of these at a connection's start."""
    from pymavlink import mavutil
    from pymavlink.dialects.v20 import common

    source = Path(mavutil.__file__).read_text(encoding="utf-8")
    names = set(re.findall(r"\bmavlink\.((?:MAV|SERIAL)_[A-Z0-9_]+)", source))
    assert len(names) > 40
    assert {name for name in names if hasattr(common, name) and not hasattr(mavlink, name)} == set()


def test_private_messages_have_free_ids() -> None:
    from pymavlink.dialects.v20 import all as everything

    private = [number for number in MESSAGES if number >= 52100]
    assert len(private) + len(STANDARD) == len(MESSAGES)
    assert not set(private) & set(everything.mavlink_map)
    assert max(private) < 60_000


@pytest.mark.parametrize("number", MESSAGES)
def test_every_message_fits_one_radio_frame(number: int) -> None:
    name, _, longest = MESSAGES[number]
    if name in SPLIT:
        assert longest + OVERHEAD > FRAME_BYTES
        return
    assert longest - UNSENT.get(name, 0) + OVERHEAD <= FRAME_BYTES


def test_telemetry_and_chunks_have_the_sizes_of_the_budget() -> None:
    sizes = {name: longest + OVERHEAD for name, _, longest in MESSAGES.values()}
    assert sizes["FC_CONTROL"] == 96
    assert sizes["FC_ESTIMATE"] == 74
    assert sizes["FC_OBSERVER"] == 28
    assert sizes["FC_ESTIMATE"] + sizes["FC_OBSERVER"] <= FRAME_BYTES
    assert sizes["FC_ROTORS"] == 24
    assert sizes["FC_ESTIMATE"] + sizes["FC_ROTORS"] <= FRAME_BYTES
    assert sizes["UPLOAD_CHUNK"] == FRAME_BYTES
    assert sizes["TIMESYNC"] == 28
    assert sizes["COMMAND_LONG"] == 45
    pose = Codec(*m.CAMERAS).encode(m.AttPosMocap(2**63, (1.0, 0.5, 0.5, 0.5), 1.0, 1.0, 1.0))
    assert len(pose) == 48
    assert 48 + sizes["COMMAND_LONG"] <= FRAME_BYTES


def test_enums_of_the_dialect_equal_those_of_the_vehicle() -> None:
    from trimtab.firmware_model.flight.failsafe import Failsafe
    from trimtab.firmware_model.flight.supervisor import State
    from trimtab.protocol.blobs import Kind

    for enum, prefix in ((State, "STATE"), (Failsafe, "FAILSAFE"), (Kind, "BLOB")):
        for member in enum:
            assert getattr(mavlink, f"TRIMTAB_{prefix}_{member.name}") == member.value
        assert len(mavlink.enums[f"TRIMTAB_{prefix}"]) - (prefix == "BLOB") == len(enum) + 1  # and ENUM_END


def test_every_field_and_message_is_described() -> None:
    root = ElementTree.parse(generate.DIALECT).getroot()
    for message in root.iter("message"):
        description = message.find("description")
        assert description is not None
        assert description.text
        assert all(field.text for field in message.iter("field"))


def test_generate_gives_the_committed_bytes(tmp_path: Path) -> None:
    pytest.importorskip("grpc_tools", reason="grpcio-tools is not installed")
    written = generate.generate(tmp_path)
    committed = sorted(path for path in generate.GENERATED.iterdir() if path.suffix in (".py", ".pyi"))
    assert [path.name for path in written] == [path.name for path in committed]
    for new, old in zip(written, committed, strict=True):
        assert new.read_bytes() == old.read_bytes(), f"{new.name}: run python -m trimtab.protocol.generate"


def test_vehicle_heartbeat_tells_the_dialect_version_and_state() -> None:
    heartbeat = m.vehicle_heartbeat(4, armed=True)
    assert m.dialect_version(heartbeat) == DIALECT_VERSION
    assert heartbeat.custom_mode & 0xF == 4
    assert heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert m.is_vehicle(heartbeat)


def test_vehicle_heartbeat_has_px4s_modes_in_its_upper_half() -> None:
    """Numbers from PX4's px4_custom_mode.h, which stock ground stations decode."""
    ready, takeoff, hold, mission, land = (0x04 | sub << 8 for sub in (1, 2, 3, 4, 6))
    offboard = 0x06
    modes = [m.vehicle_heartbeat(state, armed=True).custom_mode >> 16 for state in range(9)]
    assert modes == [ready, ready, ready, takeoff, mission, hold, land, land, offboard]


def test_heartbeat_holds_every_dialect_version_that_may_follow() -> None:
    assert DIALECT_VERSION <= 0x3F, "custom_mode has six bits for the version"


def test_heartbeats_of_others_are_told_apart() -> None:
    newer = m.vehicle_heartbeat(1, armed=False)
    newer.custom_mode += 1 << 4
    assert m.dialect_version(newer) == DIALECT_VERSION + 1
    older = m.Heartbeat(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC, 1, 0x54020001, 3, 3)
    assert m.dialect_version(older) == 2  # the layout before version 3
    px4 = m.Heartbeat(mavlink.MAV_TYPE_QUADROTOR, 12, 81, 0x03040000, 4, 3)
    assert m.is_vehicle(px4)
    assert m.dialect_version(px4) is None
    assert not m.is_vehicle(m.host_heartbeat())
    assert m.dialect_version(m.host_heartbeat()) is None
