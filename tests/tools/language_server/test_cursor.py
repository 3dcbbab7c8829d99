"""The place of the cursor in documents that are half typed."""

from __future__ import annotations

import pytest

from thorvaldc.compiler.scaffolding import robot_text
from thorvaldc.tools.language_server.cursor import cursor_at

PLACES = [
    ("|", (), "key", ""),
    ("na|", (), "key", "na"),
    ("name: |", ("name",), "value", ""),
    ("name: ca|", ("name",), "value", "ca"),
    ("name:\n  |", ("name",), "either", ""),
    ("modules:\n  fl:\n    ty|", ("modules", "fl"), "either", "ty"),
    ("modules:\n  fl:\n    type: a\n    mo|", ("modules", "fl"), "key", "mo"),
    ("modules:\n  fl:\n    type: a\n  |", ("modules",), "key", ""),
    ("modules:\n  fl:\n    type: a\n|", (), "key", ""),
    ("modules:\n  fl: {type: a}\n  fr|", ("modules",), "key", "fr"),
    ("modules:\n  fl: {|", ("modules", "fl"), "key", ""),
    ("modules:\n  fl: {ty|", ("modules", "fl"), "key", "ty"),
    ("modules:\n  fl: {type: dri|", ("modules", "fl", "type"), "value", "dri"),
    ("modules:\n  fl: {type: a, mo|}", ("modules", "fl"), "key", "mo"),
    ("modules:\n  fl: {type: a, params: {x: 1, |", ("modules", "fl", "params"), "key", ""),
    ("modules:\n  fl: {type: a,\n    mount: fr|", ("modules", "fl", "mount"), "value", "fr"),
    ("modules:\n  fl: {type: a,\n  fr: {ty|", ("modules", "fr"), "key", "ty"),
    ("modules:\n  fl: {type: 'a|", ("modules", "fl", "type"), "value", "a"),
    ('modules:\n  fl: {"ty|', ("modules", "fl"), "key", "ty"),
    ("a: [1, |", ("a", 1), "either", ""),
    ("a: [{b: 1}, {c|", ("a", 1), "key", "c"),
    ("a:\n  - b: 1\n    c: |", ("a", 0, "c"), "value", ""),
    ("a:\n  - b: 1\n  - |", ("a", 1), "either", ""),
    ("a:\n  - b: 1\n  - c|", ("a", 1), "either", "c"),
    ("a:\n- b: 1\n- c: |", ("a", 1, "c"), "value", ""),
    ("a:\n- b: 1\nd|", (), "key", "d"),
    ("a:\n  - {b: 1}\n  - {b: |", ("a", 1, "b"), "value", ""),
    ("a: |\n  b: c\nd: e|".replace("a: |", "a: >"), ("d",), "value", "e"),
    ("a: '{'\nb: {c: |", ("b", "c"), "value", ""),
    ("a: 1 # {\nb: {c: 1} # [\nd: |", ("d",), "value", ""),
    ("a: {b: 42:1, c: |", ("a", "c"), "value", ""),
    (
        "modules:\n  frame:\n    params: {length: 1.1 |",
        ("modules", "frame", "params", "length"),
        "value",
        "1.1 ",
    ),
    ("a:\r\n  b:\r\n    c: x|", ("a", "b", "c"), "value", "x"),
]


@pytest.mark.parametrize(("text", "path", "slot", "prefix"), PLACES)
def test_place_of_the_cursor(
    text: str, path: tuple[str | int, ...], slot: str, prefix: str
) -> None:
    before, _, after = text.rpartition("|")
    cursor = cursor_at(before + after, len(before))
    assert (cursor.path, cursor.slot, cursor.prefix) == (path, slot, prefix)
    assert (before + after)[cursor.start : len(before)] == prefix


def test_every_offset_of_a_robot_has_a_place() -> None:
    text = robot_text("cart", "2wd0ws")
    for offset in range(len(text) + 1):
        cursor = cursor_at(text, offset)
        assert 0 <= cursor.start <= offset
        assert offset < 20 or cursor.path[:1] in (
            (),
            ("name",),
            ("description",),
            ("driver",),
            ("base_calculator",),
            ("modules",),
        )
