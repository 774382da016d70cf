"""What the pages say about signing is what the code does."""

from __future__ import annotations

import re
from pathlib import Path

from trimtab.firmware_model.services.signing_service import TEXT_US, TEXTS
from trimtab.protocol import unsigned
from trimtab.protocol.generated.frames import MESSAGES
from trimtab.protocol.messages import mavlink
from trimtab.protocol.signing import NEW_STREAM_US, STREAMS_MAX, WINDOW_MESSAGES, WINDOW_US, Verdict
from trimtab.protocol.stream import SIGNATURE_BYTES
from trimtab.protocol.upload import SIGNED_CHUNK_BYTES
from trimtab.protocol.uwb_pieces import FRAME_BYTES

DOCS = Path(__file__).parents[2] / "docs"
LINK = (DOCS / "concepts" / "link.md").read_text(encoding="utf-8")


def test_link_page_budget_of_signed_messages_adds_up() -> None:
    text = LINK
    part = text.split("## Air budget\n", 1)[1]
    found = re.search(r"(?:^\|.*\n)+", part, flags=re.MULTILINE)
    assert found is not None
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in found[0].splitlines()[2:]]
    frames = [int(row[5].strip("*").partition(" ")[0]) for row in rows]
    assert sum(frames[:4]) == frames[4]
    assert frames[4] + frames[5] == 500
    sizes = {name: longest + 12 + SIGNATURE_BYTES for name, _, longest in MESSAGES.values()}
    assert (sizes["FC_CONTROL"], rows[1][4]) == (109, "109")
    assert (sizes["FC_OBSERVER"], sizes["FC_ESTIMATE"], rows[2][4]) == (41, 87, "41-87")
    assert (sizes["SET_ATTITUDE_TARGET"], rows[6][4]) == (64, "64")
    pose = 36 + 12 + SIGNATURE_BYTES
    assert rows[0][4] == f"{pose}-{pose + sizes['TIMESYNC']}"
    shortest = min(sizes[name] for name in ("FC_OBSERVER", "TIMESYNC", "HEARTBEAT"))
    assert sizes["FC_ESTIMATE"] + shortest > FRAME_BYTES
    assert pose + sizes["COMMAND_LONG"] > FRAME_BYTES
    left = frames[5] * SIGNED_CHUNK_BYTES
    rates = f"{left / 1000:.2f} kB/s, {0.9 * left / 1000:.1f} kB/s where a tenth"
    assert f"frames a second of {SIGNED_CHUNK_BYTES} B chunks are {rates}" in text


def test_link_page_lists_what_is_accepted_unsigned() -> None:
    text = LINK
    commands = {number: name for name, number in vars(mavlink).items() if name.startswith("MAV_CMD_")}
    vehicle = {MESSAGES[number][0]: why for number, why in unsigned.TO_VEHICLE.items()}
    vehicle |= {commands[number]: why for number, why in unsigned.COMMANDS_TO_VEHICLE.items()}
    host = {MESSAGES[number][0]: why for number, why in unsigned.TO_HOST.items()}
    part = text.split("## Signing", 1)[1].split("\n## ", 1)[0]
    rows = dict(re.findall(r"^\| ([A-Z_]+) \| (.*) \|$", part, flags=re.MULTILINE))
    assert rows == vehicle | host
    assert f"at most {WINDOW_US // 1_000_000} s older" in part
    assert f"The last {WINDOW_MESSAGES} timestamps" in part
    assert f"at most {NEW_STREAM_US // 1_000_000} s behind" in part
    assert f"remembers {STREAMS_MAX} streams" in part


def test_signing_page_has_the_texts_of_the_vehicle() -> None:
    page = (DOCS / "guide" / "signing.md").read_text(encoding="utf-8")
    assert TEXTS[Verdict.UNSIGNED] in page
    assert TEXTS[Verdict.BAD_SIGNATURE] in page
    assert f"at most every {TEXT_US // 1_000_000} s" in page
