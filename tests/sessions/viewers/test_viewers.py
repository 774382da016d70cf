"""A flown log in other people's readers, and the layout for Foxglove against a flown log."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import FieldDescriptor
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from trimtab.host.link.summary import FlightResult
from trimtab.host.log import Flight
from trimtab.host.log.display import FOXGLOVE_LAYOUT
from trimtab.host.log.mcap_file import McapFile

HERE = Path(__file__).parent
PACKAGE = ("package.json", "package-lock.json", "read_log.js")
WIDE = (FieldDescriptor.CPPTYPE_INT64, FieldDescriptor.CPPTYPE_UINT64)
SHOWN = {
    "/display/world": "foxglove.FrameTransform",
    "/display/pose": "foxglove.FrameTransform",
    "/display/vehicle": "foxglove.SceneUpdate",
    "/display/path": "foxglove.PosesInFrame",
    "/display/reference": "foxglove.PoseInFrame",
    "/display/reference_path": "foxglove.PosesInFrame",
    "/display/residual": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
}
"""Topics whose schemas Foxglove knows."""


@pytest.fixture(scope="module")
def decoded(flown: tuple[FlightResult, Flight]) -> dict[str, list[Any]]:
    """The messages of a flown log by topic, with schema and times."""
    topics: dict[str, list[Any]] = {}
    with flown[0].log.open("rb") as stream:
        for each in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            topics.setdefault(each.channel.topic, []).append(each)
    return topics


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads(FOXGLOVE_LAYOUT.read_text(encoding="utf-8"))


def plain(message: Any) -> dict[str, Any]:
    """The fields of a message that are set, as protobufjs gives them: enums by name, 64 bits as text."""

    def single(field: FieldDescriptor, value: Any) -> Any:
        if field.message_type is not None:
            return plain(value)
        if field.enum_type is not None:
            return field.enum_type.values_by_number[value].name
        return str(value) if field.cpp_type in WIDE else value

    return {
        field.name: [single(field, each) for each in value] if field.is_repeated else single(field, value)
        for field, value in message.ListFields()
    }


@pytest.mark.full  # installs packages
def test_libraries_of_others_read_every_message(
    require: Callable[[str], None],
    flown: tuple[FlightResult, Flight],
    decoded: dict[str, list[Any]],
    tmp_path: Path,
) -> None:
    require("node")
    for name in PACKAGE:
        shutil.copy(HERE / name, tmp_path / name)
    install = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    environment = {**os.environ, "npm_config_omit_lockfile_registry_resolved": "true"}
    done = subprocess.run(install, cwd=tmp_path, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"node: npm ci failed: {done.stderr.strip().splitlines()[-1:]}")
    done = subprocess.run(
        ["node", "read_log.js", str(flown[0].log)], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    counts = Counter((line["topic"], line["schema"]) for line in lines)
    print(*(f"{topic} {schema} {count}" for (topic, schema), count in sorted(counts.items())), sep="\n")
    assert len(lines) == sum(map(len, decoded.values()))
    times = [int(line["log_ns"]) for line in lines]
    assert times == sorted(times)
    by_topic: dict[str, list[Any]] = {}
    for line in lines:
        by_topic.setdefault(line["topic"], []).append(line)
    assert set(by_topic) == set(decoded)
    for topic, messages in decoded.items():
        for line, (schema, _, message, content) in zip(by_topic[topic], messages, strict=True):
            assert line == {
                "topic": topic,
                "schema": schema.name,
                "log_ns": str(message.log_time),
                "publish_ns": str(message.publish_time),
                "content": plain(content),
            }


def test_lock_of_the_packages_names_no_registry() -> None:
    assert "http" not in (HERE / "package-lock.json").read_text(encoding="utf-8")


def test_flown_log_shows_pose_paths_residual_and_vehicle(decoded: dict[str, list[Any]]) -> None:
    assert {topic: decoded[topic][0].schema.name for topic in SHOWN} == SHOWN
    once = {"/display/world", "/display/vehicle", "/display/path", "/display/reference_path"}
    assert {topic for topic in SHOWN if len(decoded[topic]) == 1} >= once
    flight_s = 1e-9 * decoded["/mocap/pose"][-1].message.log_time
    assert len(decoded["/display/pose"]) == pytest.approx(20.0 * flight_s, rel=0.03)
    tracking = len(decoded["/reference"])
    for topic in ("/display/reference", "/display/residual"):
        assert len(decoded[topic]) == pytest.approx(tracking / 5, rel=0.03)
    flown = [pose.position for pose in decoded["/display/reference_path"][0].decoded_message.poses]
    shown = decoded["/display/reference"][-1].decoded_message.pose.position
    assert (flown[-1].x, flown[-1].y, flown[-1].z) == (shown.x, shown.y, shown.z)


def test_display_topics_add_less_than_a_tenth(flown: tuple[FlightResult, Flight]) -> None:
    log, sizes = flown[0].log.read_bytes(), []
    for without in ("/display/", "none"):
        reader, stream = make_reader(io.BytesIO(log)), io.BytesIO()
        writer, schemas, channels = McapFile(stream), dict[int, int](), dict[int, int]()
        summary = reader.get_summary()
        assert summary is not None
        for channel in summary.channels.values():
            if not channel.topic.startswith(without):
                schema = summary.schemas[channel.schema_id]
                if schema.id not in schemas:
                    schemas[schema.id] = writer.add_schema(schema.name, schema.data)
                channels[channel.id] = writer.add_channel(channel.topic, schemas[schema.id], channel.metadata)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id in channels:
                times_us = message.log_time // 1000, message.publish_time // 1000
                writer.add_message(channels[channel.id], *times_us, message.data)
        writer.finish()
        sizes.append(len(stream.getvalue()))
    assert 1.0 < sizes[1] / sizes[0] < 1.1


def residuals_frd(log: Path) -> np.ndarray:
    """The arrows of a log as vectors, m/s^2."""
    vectors = []
    with log.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(["/display/residual"]):
            (arrow,) = SceneUpdate.FromString(message.data).entities[0].arrows
            q, length = arrow.pose.orientation, arrow.shaft_length
            first_column = (
                1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y)
            )  # fmt: skip
            vectors.append([length * each for each in first_column])
    return np.array(vectors)


def test_residual_points_where_the_missing_force_does(
    fly: Callable[..., FlightResult],
    simulate: Callable[..., Any],
    world_file: Callable[[str], str],
    flown: tuple[FlightResult, Flight],
) -> None:
    # Rotors 10 % above nominal hover at less command, whose nominal thrust is the weight over 1.1.
    world = world_file("[effects.thrust-gain]\ngain = 1.1\n")
    strong = residuals_frd(fly(simulate(world=world)).log)
    nominal = residuals_frd(flown[0].log)
    np.testing.assert_allclose(np.median(nominal, axis=0), 0.0, atol=0.1)
    np.testing.assert_allclose(np.median(strong, axis=0), [0.0, 0.0, -9.81 * (1.0 - 1.0 / 1.1)], atol=0.05)


def values(message: Any, path: str) -> Any:
    """The value at a path of Foxglove's in a message: names, and indices in brackets."""
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        message = getattr(message, name) if name else message[int(index)]
    return message


def message_paths(layout: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Kind of panel, topic and path within the message, of all paths in the layout."""
    for panel, config in layout["configById"].items():
        for path in config.get("paths", ()):
            topic, inner = re.fullmatch(r"([/\w]+)((?:\.\w+|\[\d+\])+)", path["value"]).groups()  # pyright: ignore[reportOptionalMemberAccess]
            yield panel.partition("!")[0], topic, inner


def test_layout_names_only_what_a_flown_log_holds(
    layout: dict[str, Any], decoded: dict[str, list[Any]]
) -> None:
    found = list(message_paths(layout))
    assert len(found) > 15
    for kind, topic, path in found:
        numbers = 0
        for each in decoded[topic]:
            try:
                value = values(each.decoded_message, path)
            except IndexError:  # an interval without means
                continue
            assert isinstance(value, int if kind == "StateTransitions" else float), (topic, path)
            numbers += 1
        assert numbers > 0.9 * len(decoded[topic]), (topic, path)
    scene, texts = layout["configById"]["3D!flight"], layout["configById"]["RosOut!log"]
    assert {*scene["topics"], texts["topicToRender"]} | {"/display/world", "/display/pose"} == set(SHOWN)
    frames = {
        frame
        for topic in ("/display/world", "/display/pose")
        for frame in (
            decoded[topic][0].decoded_message.parent_frame_id,
            decoded[topic][0].decoded_message.child_frame_id,
        )
    }
    named = [scene["followTf"], *(layer["frameId"] for layer in scene["layers"].values())]
    assert {*named, *(key.removeprefix("frame:") for key in scene["transforms"])} <= frames
    lines = {topic for topic, settings in scene["topics"].items() if settings.get("type") == "line"}
    assert {SHOWN[topic] for topic in lines} == {"foxglove.PosesInFrame"}


def test_layout_places_every_panel_once(layout: dict[str, Any]) -> None:
    def panels(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        else:
            assert node["direction"] in ("row", "column")
            yield from panels(node["first"])
            yield from panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_verb_writes_the_layout_and_overwrites_nothing(
    run_trimtab: Callable[..., tuple[int, dict[str, Any], str]], layout: dict[str, Any], tmp_path: Path
) -> None:
    code, told, _ = run_trimtab("log", "layout", "--json")
    assert (code, told) == (0, {"layout": "trimtab.foxglove.json"})
    assert json.loads((tmp_path / "trimtab.foxglove.json").read_text(encoding="utf-8")) == layout
    code, told, complaint = run_trimtab("log", "layout", "--json")
    assert (code, told["exit_code"]) == (2, 2)
    assert len(complaint.strip().splitlines()) == 1
    assert run_trimtab("log", "layout", "--force")[0] == 0
    assert run_trimtab("log", "layout", "-o", "none/layout.json")[0] == 2
