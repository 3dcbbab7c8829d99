"""Documents for the tests of the language server."""

from __future__ import annotations

from lsprotocol import types

from thorvaldc.compiler.scaffolding import robot_text

ROBOT = robot_text("cart", "4wd4ws")
POST = """\
thorvaldc: 1
description: A post.
params:
  size: {quantity: length, default: 10 cm, minimum: 1 mm, description: Size., source: "chosen: x"}
  wheel: {type: module, default: wheel/agri_200, description: Wheel., source: "chosen: x"}
let: {half: "${size / 2}"}
mount: {kinds: [frame_clamp], link: post}
links:
  post: {parts: [{shape: {box: ["${size}", "${half}", 0.1]}, mass: 1 kg, source: "chosen: x"}]}
ports: {top: {kind: frame_clamp, xyz: [0, 0, 100 mm], rpy: [0, 0, 90 deg]}}
"""
WITH_POST = (
    ROBOT.replace("modules:", "library: [my modules]\nmodules:", 1)
    + "  post: {type: my/post, mount: frame.front_center}\n"
)


def edited(text: str, edits: list[types.TextEdit]) -> str:
    """Returns a text after edits, as an editor applies them."""
    lines = text.splitlines(keepends=True)
    for edit in sorted(edits, key=lambda e: (e.range.start.line, e.range.start.character))[::-1]:
        starts = []
        for place in (edit.range.start, edit.range.end):
            before = "".join(lines[: place.line])
            line = lines[place.line] if place.line < len(lines) else ""
            units = line.encode("utf-16-le")[: 2 * place.character]
            starts.append(len(before) + len(units.decode("utf-16-le")))
        whole = "".join(lines)
        lines = (whole[: starts[0]] + edit.new_text + whole[starts[1] :]).splitlines(keepends=True)
    return "".join(lines)
