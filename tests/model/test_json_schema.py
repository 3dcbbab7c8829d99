"""The JSON Schema of ``model.json``: it is the contract that files and reader keep."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import jsonschema
import pytest

from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.model.test_model_json import GOOD, changed, everything
from thorvaldc.model import Fleet, Placement, Pose
from thorvaldc.model.model_json import VERSION, model_schema, model_schema_text, to_json

# The fields and types of each version.  Do not change an entry: a program that reads the
# version exists.  When the fields change, increase VERSION, add an entry here, and a line in the
# table of versions in docs/model.md.
FINGERPRINTS = {
    2: "bd8687645e15f71b",
    3: "63f3bc7bf99cdf3b",
    4: "9a53c07dbe71e660",
    5: "05ce76bf36bb8ee5",
    6: "cdf1ea8ff9bb55d2",
    7: "77f7cfb0375a3997",
    8: "3b49848e2c94a3b5",
    9: "cae85acd79a59b5c",
    10: "eeb8ff37e77e8014",
    11: "12f0de925b7a4a74",
    12: "aba667ae81428e75",
    13: "1f486205ccc8da90",
    14: "bf009fcf802423d8",
    15: "b53a2f5500812590",
}

SCHEMA = model_schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def fingerprint(schema: dict[str, Any]) -> str:
    """The hash of a schema without its descriptions, quantities and version."""

    def bare(value: Any) -> Any:
        if isinstance(value, dict):
            said = ("description", "x-quantity")
            return {key: bare(item) for key, item in value.items() if key not in said}
        return [bare(item) for item in value] if isinstance(value, list) else value

    contract = bare({key: value for key, value in schema.items() if key in ("$defs", "allOf")})
    # The order of fields is that of the file, so it counts.
    return hashlib.sha256(json.dumps(contract).encode()).hexdigest()[:16]


def test_changed_fields_have_a_new_version() -> None:
    assert FINGERPRINTS.get(VERSION) == fingerprint(SCHEMA), (
        "the fields of model.json changed: increase VERSION in thorvaldc/model/model_json.py, and "
        f"add {fingerprint(SCHEMA)!r} to FINGERPRINTS and a line to docs/model.md"
    )


def test_the_fingerprint_is_that_of_the_fields() -> None:
    changed_schema = json.loads(json.dumps(SCHEMA))
    changed_schema["$defs"]["Wheel"]["description"] = "other words"
    assert changed_schema["$defs"]["Wheel"]["properties"]["load"].pop("x-quantity") == "force"
    assert fingerprint(changed_schema) == fingerprint(SCHEMA)
    changed_schema["$defs"]["Wheel"]["properties"]["colour"] = {"type": "string"}
    assert fingerprint(changed_schema) != fingerprint(SCHEMA)


def test_it_is_a_schema_that_stands_alone() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert json.loads(model_schema_text()) == SCHEMA
    assert SCHEMA["properties"]["version"]["const"] == VERSION


def test_every_class_is_described() -> None:
    for name, definition in SCHEMA["$defs"].items():
        description = definition["description"]
        assert description.endswith("."), name
        assert not description.startswith(f"{name}("), f"{name} has no docstring"


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_examples_are_valid(name: str) -> None:
    VALIDATOR.validate(json.loads(to_json(example_robot(name))))


@pytest.mark.parametrize("name", FLEETS)
def test_fleets_are_valid(name: str) -> None:
    VALIDATOR.validate(json.loads(to_json(example_fleet(name))))


def test_a_model_with_everything_in_it_is_valid() -> None:
    VALIDATOR.validate(json.loads(to_json(everything())))
    fleet = Fleet("f", "", (Placement("a", Pose(), everything()),))
    VALIDATOR.validate(json.loads(to_json(fleet)))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("version", 1),
        ("format", "urdf"),
        ("kind", "Fleet"),
        ("kind", "Rover"),
        ("model", []),
        ("model.wheels.2.treads", ...),
        ("model.wheels.2.tread", []),
        ("model.name", 3),
        ("model.driver.rate", "fast"),
        ("model.driver.rate", True),
        ("model.joints.0.pose.xyz", [0.0, 1.0]),
        ("model.links.0.span", ["robot.yaml"] * 9),
        ("model.links.1.visuals.0.shape.kind", "Cone"),
        ("model.links.1.visuals.0.shape.kind", ...),
        ("model.actuators.0.encoder_ppr", 1024.5),
    ],
)
def test_what_the_reader_refuses_is_not_valid(path: str, value: Any) -> None:
    VALIDATOR.validate(GOOD)
    assert not VALIDATOR.is_valid(json.loads(changed(path, value)))
