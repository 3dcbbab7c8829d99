"""Tests of the diagnostics of invalid documents: one per mistake, with its span and hint."""

from __future__ import annotations

import pytest

from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Diagnostic, Report
from thorvaldc.schema import Kind

ROBOT = "thorvaldc: 1\nname: r\nmodules:\n  a: {type: x}\n"
MODULE = "thorvaldc: 1\ndescription: x\n"


def check_text(text: str, kind: Kind = "robot") -> list[Diagnostic]:
    report = Report()
    node = read_text(text.encode(), "f.yaml", report)
    assert node is not None
    assert check(node, kind, report) is not report.has_errors
    return report.sorted()


def only_diagnostic(text: str, kind: Kind = "robot") -> Diagnostic:
    (diagnostic,) = check_text(text, kind)
    return diagnostic


@pytest.mark.parametrize(
    ("text", "kind", "code", "position", "message", "hint"),
    [
        (
            ROBOT + "descripton: x\n",
            "robot",
            "unknown-key",
            "5:1",
            "the robot document has no key `descripton`",
            "did you mean `description`?",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, xyz: [0, 0, 0]}"),
            "robot",
            "unknown-key",
            "4:16",
            "`a` has no key `xyz`",
            "`xyz` belongs under `mount`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, gear_ratio: 3}"),
            "robot",
            "unknown-key",
            "4:16",
            "`a` has no key `gear_ratio`",
            "parameters of the module's type belong under `params`",
        ),
        (
            ROBOT.replace("{type: x}", "{}"),
            "robot",
            "missing-key",
            "4:3",
            "`a` has no `type`",
            "add it, as in `type: assembly/steered_drive`",
        ),
        (
            ROBOT.replace("{type: x}", "[x]"),
            "robot",
            "wrong-type",
            "4:6",
            "expected a mapping, got a list",
            None,
        ),
        (
            ROBOT.replace("{type: x}", "{type: 3}"),
            "robot",
            "wrong-type",
            "4:13",
            "expected text, got `3`",
            "as in `assembly/steered_drive`",
        ),
        (
            ROBOT + "driver: {rate: true}\n",
            "robot",
            "wrong-type",
            "5:16",
            "expected a frequency, got `true`",
            "as in `50 Hz`",
        ),
        (
            ROBOT + "driver:\n",
            "robot",
            "wrong-type",
            "5:1",
            "`driver` has no value",
            "remove the key, or give it a value, as in `{rate: 50 Hz, max_linear_velocity: 1 m/s}`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, can: 3.0}"),
            "robot",
            "wrong-type",
            "4:21",
            "expected a whole number, `auto` or a mapping, got `3.0`",
            "as in `3`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, can: {serial: 0x12}}"),
            "robot",
            "wrong-type",
            "4:30",
            "expected text, got `18`",
            'as in `"0x12"`',
        ),
        (
            ROBOT.replace("  a:", "  Front Left:"),
            "robot",
            "bad-id",
            "4:3",
            "`Front Left` is not a valid name",
            "a name has lower-case letters, digits and `_`, begins with a letter, and has at most "
            "64 characters, as in `front_left`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, mount: a-b.c}"),
            "robot",
            "bad-id",
            "4:23",
            "`a-b.c` is not a path of names",
            "write names joined by dots, as in `a_b.c`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, mount: {parent: b, xyz: [0, 0]}}"),
            "robot",
            "wrong-length",
            "4:40",
            "`xyz` has 2 elements; expected 3",
            "as in `[0, 0.285, 70 mm]`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, mount: {parent: b, xyz: [0, 0, 5 kg]}}"),
            "robot",
            "wrong-dimension",
            "4:47",
            "`5 kg` is a mass; expected a length",
            "write a length as in `5 mm`",
        ),
        (
            ROBOT.replace("{type: x}", "{type: x, mount: {parent: b, xyz: [0, 0, 0.5 kg]}}"),
            "robot",
            "wrong-dimension",
            "4:47",
            "`0.5 kg` is a mass; expected a length",
            "write a length as in `0.5 m`",
        ),
        (
            ROBOT + "driver: {rate: '${50}'}\n",
            "robot",
            "expression-not-allowed",
            "5:16",
            "a robot document cannot contain expressions",
            "write the value; expressions belong in module documents",
        ),
        (
            "thorvaldc: 2\n" + ROBOT[13:],
            "robot",
            "language-version",
            "1:12",
            "the file is in version 2 of the language; this program reads 1",
            "install a newer thorvaldc: it reads this file, and older ones",
        ),
        (
            MODULE + "joints: {j: {type: hinge, parent: a, child: b}}\n",
            "module",
            "unknown-value",
            "3:20",
            "`type` cannot be `hinge`",
            "allowed values are `revolute`, `continuous`, `prismatic`, `fixed`",
        ),
        (
            MODULE + "joints: {j: {type: '${x}', parent: a, child: b, lower: 5 kg}}\n",
            "module",
            "wrong-dimension",
            "3:56",
            "`5 kg` is a mass; expected an angle or a length",
            "write an angle as in `5 deg`",
        ),
        (
            MODULE + "links: {a: {parts: [{shape: {sphere: {radius: 1}}, mass: 1}]}}\n",
            "module",
            "missing-key",
            "3:52",
            "`mass` requires `source` in the same mapping",
            'add it, as in `source: "estimated: proportions in figure 3 of the paper"`',
        ),
        (
            MODULE + "links: {a: {parts: [{color: red}]}}\n",
            "module",
            "conflicting-keys",
            "3:21",
            "an element of `parts` has none of `shape`, `mass`; one is required",
            "add `shape` or `mass`",
        ),
        (
            MODULE + "modules: {a: {type: b}}\nports: {x: {kind: a}}\n",
            "module",
            "wrong-type",
            "4:12",
            "expected text, got a mapping",
            "as in `steering.top`",
        ),
        (
            "thorvaldc: 1\nname: f\nrobots: {a: {robot: r.yaml, yaw: 3 m}}\n",
            "fleet",
            "wrong-dimension",
            "3:34",
            "`3 m` is a length; expected an angle",
            "write an angle as in `3 deg`",
        ),
    ],
)
def test_messages(
    text: str, kind: Kind, code: str, position: str, message: str, hint: str | None
) -> None:
    diagnostic = only_diagnostic(text, kind)
    assert (diagnostic.code.name, str(diagnostic.span), diagnostic.message, diagnostic.hint) == (
        code,
        f"f.yaml:{position}",
        message,
        hint,
    )


def test_keys_that_exclude_each_other_are_both_shown() -> None:
    diagnostic = only_diagnostic(
        ROBOT.replace("{type: x}", "{type: x, mount: {port: b.c, parent: b}}")
    )
    assert (diagnostic.code.name, str(diagnostic.span)) == ("conflicting-keys", "f.yaml:4:35")
    assert [str(label.span) for label in diagnostic.labels] == ["f.yaml:4:24"]


def test_one_run_reports_all_mistakes_with_their_lines() -> None:
    text = """thorvaldc: 1
name: R
driver: {rate: 5 kg, speed: 3}
modules:
  a: {typ: x, mount: [1]}
  b: {type: x, params: {X: 1}, can: -1}
  c: foo
"""
    assert [(d.code.name, d.span.line) for d in check_text(text) if d.span] == [
        ("bad-id", 2),
        ("wrong-dimension", 3),
        ("unknown-key", 3),
        ("unknown-key", 5),
        ("wrong-type", 5),
        ("bad-id", 6),
        ("out-of-range", 6),
        ("wrong-type", 7),
    ]


def test_a_value_that_the_reader_rejected_gets_no_second_diagnostic() -> None:
    assert only_diagnostic(ROBOT + "name2: on\n".replace("name2", "description")).code.name == (
        "yaml-ambiguous-word"
    )


@pytest.mark.parametrize("text", ["[1]", "x", "3", "true"])
def test_a_document_is_a_mapping(text: str) -> None:
    assert only_diagnostic(text).code.name == "wrong-type"


def test_invalid_values_are_replaced_by_none() -> None:
    report = Report()
    text = ROBOT + "driver: {rate: 5 kg, command_timeout: 1 s}\nname2: x\n"
    node = read_text(text.encode(), "f.yaml", report)
    assert node is not None
    assert not check(node, "robot", report)
    remaining = without_invalid_values(node, report)
    assert remaining.plain()["driver"] == {"rate": None, "command_timeout": "1 s"}
    assert remaining.plain()["modules"] == {"a": {"type": "x"}}
    assert remaining.get("driver").span == node.get("driver").span  # type: ignore[union-attr]
