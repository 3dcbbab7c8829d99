"""Tests that the walk agrees with jsonschema, on valid documents and random mistakes."""

from __future__ import annotations

import copy
import random
from pathlib import Path
from typing import Any

import pytest

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.document_check import _validator
from thorvaldc.compiler.validation.schema_walk import _ANNOTATIONS, _CHECKS, SchemaWalk
from thorvaldc.diagnostics import Report, Span
from thorvaldc.schema import KINDS, Kind, inlined

ROOT = Path(__file__).resolve().parents[3]
FILES: dict[Kind, list[Path]] = {
    "module": sorted(ROOT.glob("modules/*/*/module.yaml")),
    "robot": sorted([*ROOT.glob("templates/robot/*.yaml"), *ROOT.glob("examples/*/robot.yaml")]),
    "fleet": sorted(ROOT.glob("examples/*/fleet.yaml")),
    "scenario": sorted(ROOT.glob("examples/scenarios/*.yaml")),
    "study": sorted(ROOT.glob("examples/studies/*/study.yaml")),
    "bus_faults": sorted(ROOT.glob("examples/bus_faults/*.yaml")),
    "calibration": [ROOT / "tests/compiler/robot_settings/calibration.yaml"],
    "device_memory": [ROOT / "tests/simulation/bus/device_memory.json"],
}
UNEXPECTED = [
    None,
    True,
    1,
    1.0,
    -3,
    1e9,
    "",
    "x",
    "1 m",
    "${a}",
    "A b",
    [],
    [1],
    [0, 0, 0],
    {},
    {"x": 1},
]


def plain(path: Path) -> Any:
    text = path.read_text(encoding="utf-8").replace("@NAME@", "mine")
    node = read_text(text.encode(), path.name, Report())
    assert node is not None
    return node.plain()


def node_of(value: Any) -> Node:
    """Returns a document of plain dicts, lists and scalars as nodes."""
    if isinstance(value, dict):
        value = {key: node_of(entry) for key, entry in value.items()}
    elif isinstance(value, list):
        value = tuple(map(node_of, value))
    return Node(value, Span("a.yaml"))


def fits(schema: dict[str, Any], value: Any) -> bool:
    return SchemaWalk("module").fits(schema, node_of(value))


def values_with_keys(value: Any) -> list[tuple[Any, Any]]:
    """Returns the container and the key of every value in a document."""
    entries = value.items() if isinstance(value, dict) else enumerate(value)
    keys = [(value, key) for key, _ in entries]
    for inner in value.values() if isinstance(value, dict) else value:
        if isinstance(inner, dict | list):
            keys += values_with_keys(inner)
    return keys


def mutate(document: Any, chance: random.Random) -> Any:
    """Makes one mistake: removes or replaces a value, adds one, or misspells a key."""
    changed = copy.deepcopy(document)
    container, key = chance.choice(values_with_keys(changed))
    kind = chance.randrange(4)
    if kind == 0:
        del container[key]
    elif kind == 1:
        container[key] = copy.deepcopy(chance.choice(UNEXPECTED))
    elif isinstance(container, list):
        container.insert(key, chance.choice(UNEXPECTED))
    elif kind == 2:
        container[chance.choice(["odd", "modules", "links", "mass", "Port"])] = chance.choice(
            UNEXPECTED
        )
    else:
        container[f"{key}x"] = container.pop(key)
    return changed


@pytest.mark.parametrize("kind", KINDS)
def test_valid_documents_fit(kind: Kind) -> None:
    for path in FILES[kind]:
        assert fits(inlined(kind), plain(path)), path


@pytest.mark.parametrize("kind", KINDS)
def test_the_walk_agrees_with_jsonschema(kind: Kind) -> None:
    validator = _validator(kind)
    chance = random.Random(1)
    documents = [plain(path) for path in FILES[kind]]
    invalid = 0
    for turn in range(300):
        document = mutate(documents[turn % len(documents)], chance)
        valid = validator.is_valid(document)
        invalid += not valid
        assert fits(inlined(kind), document) == valid, document
    assert 100 < invalid < 300


def test_a_module_in_a_parameter_of_a_module_in_a_parameter_is_checked() -> None:
    """A definition that contains itself is repeated to its second level, and ends there."""
    robot = plain(ROOT / "examples/4wd4ws_wide/robot.yaml")
    wheel: dict[str, Any] = {"type": "wheel/agri_200"}
    drive = {"type": "drive/standard", "params": {"wheel": wheel}}
    robot["modules"]["fl"] |= {"params": {"drive": drive}}
    assert fits(inlined("robot"), robot)
    wheel["colour"] = 1
    assert not fits(inlined("robot"), robot)


@pytest.mark.parametrize("kind", KINDS)
def test_the_walk_knows_every_keyword_of_the_schemas(kind: Kind) -> None:
    def keywords(schema: Any) -> set[str]:
        if not isinstance(schema, dict):
            return set()
        parts = [schema[key] for key in schema.keys() & {"items", "not", "if", "then", "else"}]
        parts += [schema.get("additionalProperties"), *schema.get("anyOf", ())]
        parts += schema.get("properties", {}).values()
        return set(schema).union(*map(keywords, parts))

    assert keywords(inlined(kind)) <= _CHECKS.keys() | _ANNOTATIONS


@pytest.mark.parametrize("value", [True, False, 0, 1, 1.0, "1", None])
@pytest.mark.parametrize("schema", [{"const": 1}, {"enum": [True, "1"]}, {"minimum": 1}])
def test_booleans_are_not_numbers(value: Any, schema: dict[str, Any]) -> None:
    from jsonschema import Draft202012Validator

    assert fits(schema, value) == Draft202012Validator(schema).is_valid(value)
