"""The layout for Foxglove: every topic, field and frame in it is in the record beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model.scenario import GROUPS
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.records.recorder import record_ticks
from thorvaldc.simulation.simulation_run import Simulation

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def record(name: str, path: Path, groups: tuple[str, ...]) -> tuple[Any, dict[str, Any]]:
    """Returns the layout of a record, and the last message on each topic of the record."""
    model = compile_file(EXAMPLES / name).model
    assert model is not None
    simulation = Simulation(model)
    recorder = McapRecorder(path, [*simulation.robots.items()], groups)
    simulation.run(0.1, [], None, record_ticks([recorder]))
    recorder.close()
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = {c.topic: m for _, c, _, m in reader.iter_decoded_messages()}
    return json.loads(path.with_suffix(".foxglove.json").read_text()), messages


def panels_of(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        yield from (*panels_of(node["first"]), *panels_of(node["second"]))


def value_of(path: str, messages: dict[str, Any]) -> float:
    topic, *parts = path.split(".")
    value = messages[topic]
    for part in parts:
        field, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", part).groups()
        value = getattr(value, field)
        value = value if index is None else value[int(index)]
    return value


@pytest.mark.parametrize(
    ("name", "groups", "series"),
    [
        ("4wd4ws_slim/robot.yaml", GROUPS, 16),
        ("fleet_of_four/fleet.yaml", GROUPS, 4 * 8 + 18 + 16),
        ("4wd4ws_slim/robot.yaml", ("truth",), 2),
        ("4wd4ws_slim/robot.yaml", ("joints",), 8),
        ("2wd0ws_greenhouse/robot.yaml", ("joints",), 2),
    ],
)
def test_all_that_a_layout_shows_is_in_the_record(
    tmp_path: Path, name: str, groups: tuple[str, ...], series: int
) -> None:
    layout, messages = record(name, tmp_path / "a.mcap", groups)
    panels = layout["configById"]
    assert sorted(panels_of(layout["layout"])) == sorted(panels)
    paths = [path for panel in panels.values() for path in panel.get("paths", ())]
    assert len({path["label"] for path in paths}) == len(paths) == series
    for path in paths:
        assert isinstance(value_of(path["value"], messages), float), path
    scene = panels["3D!robots"]
    assert set(scene["topics"]) <= set(messages)
    urdfs = [layer["topic"] for layer in scene["layers"].values() if "topic" in layer]
    assert sorted(urdfs) == sorted(topic for topic in messages if "description" in topic)
    frames = {
        frame
        for topic in ("/tf", "/tf_static")
        if topic in messages
        for t in messages[topic].transforms
        for frame in (t.header.frame_id, t.child_frame_id)
    }
    assert scene["followTf"] in frames


def test_labels_of_joints_are_the_names_in_the_messages(tmp_path: Path) -> None:
    layout, messages = record("4wd4ws_slim/robot.yaml", tmp_path / "a.mcap", ("joints",))
    for panel in layout["configById"].values():
        for path in panel.get("paths", ()):
            index = int(re.search(r"\[(\d+)\]", path["value"]).group(1))
            assert messages["/joint_states"].name[index] == path["label"]
