"""The pages on effects, imports, the link and flight logs say what the code does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest
from generators import api, bounds, effects, failsafes, rules
from google.protobuf.message import Message

from trimtab.firmware_model.services.files import FILES
from trimtab.firmware_model.services.ftp import IDLE_US, SESSIONS_MAX
from trimtab.firmware_model.services.streams import STATION_US, STREAMS
from trimtab.host.effects import load_effects
from trimtab.host.imports.airborne import CLEAR_M, EDGE_US, SHORTEST_US
from trimtab.host.imports.formats import FORMATS, crazyflie_usd, nanobench, rosbag
from trimtab.host.imports.formats.csv import ColumnMap, read_map
from trimtab.host.imports.recording import Unknown
from trimtab.host.imports.write import DECLARED_MASS_SIGMA
from trimtab.host.link.client import TIMESYNC_FIRST_US, TIMESYNC_US
from trimtab.host.link.control_stream import (
    ALIGNED_RAD,
    APPROACH_MAX_US,
    ESTIMATE_AGE_MAX_US,
    HOLD_US,
    LEAD_US,
    NEAR_M,
    RESTING_US,
    SLOW_M_S,
)
from trimtab.host.link.flight_tasks import SILENCE_US
from trimtab.host.link.host_control import COMPUTING_US, ControlStop
from trimtab.host.link.tasks import PATIENCE_US
from trimtab.host.log import IMPORTED_TOPICS
from trimtab.host.log.control_report import LATE_US
from trimtab.host.log.topics import CONTROLLED_TOPICS
from trimtab.host.trace.decision.findings import Verdict
from trimtab.host.trace.decision.rules import table as table_of_rules
from trimtab.host.vehicle.strict_toml import Strict
from trimtab.protocol.generated.frames import MESSAGES
from trimtab.protocol.messages import UploadState
from trimtab.protocol.parameters import DEFAULTS
from trimtab.protocol.upload import CHUNK_BYTES, SenderState
from trimtab.protocol.uwb_pieces import FRAME_BYTES
from trimtab.sitl.world import RadioSettings, SerialSettings, TimingSettings

DOCS = Path(__file__).parents[2] / "docs"


def text_of(name: str) -> str:
    (page,) = DOCS.rglob(name)
    return page.read_text(encoding="utf-8")


def table(text: str, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, without its head."""
    part = text.split(f"## {heading}\n", 1)[1]
    rows = re.search(r"(?:^\|.*\n)+", part, flags=re.MULTILINE)
    assert rows is not None
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[0].splitlines()[2:]]


def test_effects_page_is_the_one_the_code_makes() -> None:
    assert text_of("effects.md") == effects.page(load_effects()), "run `make docs`"


def test_correction_page_says_how_every_effect_is_corrected_or_why_not() -> None:
    assert table(text_of("guide/correction.md"), "What is corrected") == [
        [f"`{name}`", "no" if closing.law is None else "yes", closing.law or closing.no_law]
        for name, closing in ((effect.name, effect.closing) for effect in load_effects().values())
    ]


def test_rules_page_is_the_one_the_code_makes() -> None:
    assert text_of("tracing-rules.md") == rules.page(table_of_rules()), "run `make docs`"


def test_bounds_page_is_the_one_the_code_makes() -> None:
    assert text_of("bounds.md") == bounds.page(), "run `make docs`"


def test_failsafes_page_is_the_one_the_code_makes() -> None:
    assert text_of("failsafes.md") == failsafes.page(), "run `make docs`"


def test_python_page_is_the_one_the_code_makes() -> None:
    assert text_of("reference/python.md") == api.page(), "run `make docs`"


def test_python_page_refuses_a_docstring_that_misses_something() -> None:
    def half(first: int, second: int) -> int:
        """Return one.

        Parameters
        ----------
        first
            The first.
        """
        return first + second

    with pytest.raises(api.DocstringError, match="documents"):
        list(api.function_lines("half", half))


def test_imports_page_names_every_format_and_every_unknown() -> None:
    text = text_of("imports.md")
    named = re.findall(r"^\| `([a-z-]+)` \|", text.split("## What comes in")[0], flags=re.MULTILINE)
    assert tuple(named) == FORMATS
    rows = table(text, "What is declared unknown")
    assert [row[0].strip("`") for row in rows] == list(get_args(Unknown))
    for name, of_nanobench, of_usd, leaves in rows:
        word = name.strip("`")
        assert (word in nanobench.UNKNOWN) == (not of_nanobench.startswith("known")), word
        assert (word in crazyflie_usd.UNKNOWN) == (not of_usd.startswith("known")), word
        assert [effect for effect in leaves.split(", ") if effect] == [
            effect.name
            for effect in load_effects().values()
            if word in (*effect.replaced_by, *effect.freed_by)
        ]
    for figure in (f"{CLEAR_M:g} m", f"known to {100 * DECLARED_MASS_SIGMA:g} %"):
        assert figure in text
    assert (EDGE_US, SHORTEST_US) == (500_000, 2_000_000)  # "half a second", "less than two seconds"


def test_imports_page_names_every_key_of_a_column_map(tmp_path: Path) -> None:
    text = text_of("imports.md")
    named = {key for row in table(text, "Column maps") for key in re.findall(r"`([a-z0-9_]+)`", row[0])}
    assert named == set(ColumnMap.model_fields)
    columns, topics = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    (tmp_path / "map.toml").write_text(columns)
    assert read_map(tmp_path / "map.toml").motor_command_full == 65535
    (tmp_path / "map.toml").write_text(topics)
    assert rosbag.read_map(tmp_path / "map.toml").pose == "/cf1/pose"


def test_link_page_budget_adds_up() -> None:
    text = text_of("link.md")
    for name, size in re.findall(r"([A-Z_]{4,}) (\d+) B", text):
        (longest,) = [length for known, _, length in MESSAGES.values() if known == name]
        # A pose without its covariance, which is an extension, has 36 B.
        assert int(size) == (36 if name == "ATT_POS_MOCAP" else longest) + 12, name
    rows = table(text, "Air budget")
    frames = [int(row[3].strip("*").partition(" ")[0]) for row in rows]
    assert sum(frames[:4]) == frames[4]
    assert frames[4] + frames[5] == 1_000_000 // RadioSettings().slot_us == 500
    assert rows[6][2] == "51"
    assert frames[6] < frames[5]
    for row in rows[:3]:
        assert int(row[2].rpartition("-")[2]) <= FRAME_BYTES
    left = frames[5] * CHUNK_BYTES
    assert (
        f"of {CHUNK_BYTES} B chunks are {left / 1000:.2f} kB/s, {0.9 * left / 1000:.1f} kB/s where a tenth"
        in text
    )


def test_link_page_has_the_simulators_defaults() -> None:
    text, chosen = text_of("link.md"), RadioSettings()
    told = dict(row[:2] for row in table(text, "Design choices"))
    assert told["frame"].startswith(f"{FRAME_BYTES} B")
    assert f"slots of {chosen.slot_us / 1000:g} ms" in told["channel"]
    assert (
        told["delay"]
        == f"{chosen.latency_us / 1000:g} ms after the slot, up to {chosen.jitter_us / 1000:g} ms more"
    )
    assert told["loss"].startswith(
        f"{100 * chosen.loss:g} % of full frames in spells of {chosen.burst_frames:g}"
    )
    assert (
        told["duplicates, damage"] == f"{100 * chosen.duplicate:g} % and {100 * chosen.corrupt:g} % of frames"
    )


@pytest.mark.parametrize(
    ("name", "settings"),
    [("radio", RadioSettings()), ("serial", SerialSettings()), ("timing", TimingSettings())],
)
def test_simulator_page_has_every_setting_and_its_default(name: str, settings: Strict) -> None:
    part = text_of("simulator.md").split(f"| `[{name}]` | default | |\n")[1].split("\n\n")[0]
    told = {}
    for row in part.splitlines()[1:]:
        keys, values = (cell.strip() for cell in row.strip("|").split("|")[:2])
        told |= dict(zip(re.findall(r"`(\w+)`", keys), values.split(", "), strict=True))
    words = {None: told.get("bit_rate" if name == "radio" else "chunk_bytes"), (): "none"}
    for key, default in settings.model_dump().items():
        assert told.pop(key) == words.get(
            default, str(default).removesuffix(".0") if name == "timing" else str(default)
        )
    assert not told


def test_link_page_names_every_state_message_and_time() -> None:
    text = text_of("link.md")
    part = text.split("## Upload\n", 1)[1]
    states = [row[0] for row in re.findall(r"^\| ([A-Z]+) \|(.*)$", part, flags=re.MULTILINE)]
    # LIVE is what is answered about a blob in use, never a state of the receiver.
    assert set(states) == {s.name for s in UploadState if s is not UploadState.LIVE} | {
        s.name for s in SenderState
    }
    for name, _, _ in MESSAGES.values():
        if name.startswith("UPLOAD_"):
            assert f"| {name} |" in text
    assert f"gives a port {PATIENCE_US / 1e6:g} s" in text
    assert f"silent for {SILENCE_US / 1e6:g} s in flight" in text
    assert f"every {1e-3 * TIMESYNC_US:g} ms ({1e-3 * TIMESYNC_FIRST_US:g} ms until" in text


OURS = [
    topic.message
    for topic in (*CONTROLLED_TOPICS, *IMPORTED_TOPICS)
    if topic.message.DESCRIPTOR.file.package == "trimtab"
]


@pytest.mark.parametrize("message", dict.fromkeys(OURS), ids=lambda message: message.__name__)
def test_flight_log_page_names_every_field(message: type[Message]) -> None:
    name, found, fields = message.DESCRIPTOR.name, "", set[str]()
    for row in table(text_of("flight-log.md"), "Fields"):
        found = row[0] or found
        if found == name:
            fields |= set(re.findall(r"`([a-z0-9_]+)`", row[1]))
    assert fields == {field.name for field in message.DESCRIPTOR.fields}


def test_flight_log_page_names_every_topic_and_how_it_is_sampled() -> None:
    text = text_of("flight-log.md")
    for topic in (*CONTROLLED_TOPICS, *IMPORTED_TOPICS):
        assert f"`{topic.name}`" in text
        for field in topic.averaged:
            assert re.search(rf"`{field}`.*\*\*means over the interval\*\*", text)


def test_link_page_tells_the_times_of_a_controller_s_stream() -> None:
    text = text_of("link.md")
    for words in (
        f"computing time ({1e-3 * COMPUTING_US:g} ms by default)",
        f"within\n   {100 * NEAR_M:g} cm, {SLOW_M_S:g} m/s and {ALIGNED_RAD:g} rad of the first node",
        f"for {1e-6 * RESTING_US:g} s",
        f"The reference starts {1e-6 * LEAD_US:g} s later",
        f"holds the last node for {1e-6 * HOLD_US:g} s",
        f"no estimate for {1e-6 * ESTIMATE_AGE_MAX_US:g} s",
        f"first node within {1e-6 * APPROACH_MAX_US:g} s",
        f"`FS_OFFB_S` ({DEFAULTS['FS_OFFB_S']:g} s)",
    ):
        assert words in text, words
    assert f"more than {1e-3 * LATE_US:g} ms after the declared" in text_of("json.md")
    for stop in ControlStop:
        assert f"`{stop}`" in text_of("json.md")


@pytest.mark.full
def test_tracing_pages_notebook_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", text_of("guide/tracing.md"), flags=re.DOTALL)
    for log in (DOCS.parent / "tests" / "data").glob("*.mcap"):
        (tmp_path / log.name).symlink_to(log)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "tracing.md", "exec"), {})
    told = capsys.readouterr().out
    assert any(told.find(verdict) >= 0 for verdict in Verdict)


def test_link_page_tells_the_rates_of_stock_telemetry_as_they_are() -> None:
    rows = re.findall(
        r"^\| ([A-Z_, ]+)(?: \(.*\))? \| (\d+ Hz|on request) \| (\d+) Hz \|$",
        text_of("link.md"),
        flags=re.MULTILINE,
    )
    told = {name: row[1:] for row in rows for name in row[0].strip().split(", ")}
    assert told == {
        MESSAGES[number][0]: (
            "on request" if stream.default_us < 0 else f"{1_000_000 // stream.default_us} Hz",
            str(1_000_000 // stream.min_us),
        )
        for number, stream in STREAMS.items()
    }


def test_link_page_names_every_file_and_its_limits() -> None:
    text = text_of("link.md")
    assert set(re.findall(r"`/(\w+/\w+\.\w+)`", text)) >= set(FILES)
    assert (SESSIONS_MAX, IDLE_US, STATION_US) == (8, 30_000_000, 5_000_000)
    for words in ("eight sessions", "ends after 30 s", "ends 5 s after the last"):
        assert words in text
