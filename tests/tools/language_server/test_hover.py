"""The text at a key, a value or a reference."""

from __future__ import annotations

import pytest

from tests.tools.language_server.conftest import Editor
from tests.tools.language_server.texts import POST, ROBOT, WITH_POST

pytestmark = pytest.mark.asyncio(loop_scope="package")

HOVERS = [
    ("robot.yaml", "base_cal|culator:", ["Base calculator, which converts", "default `general`"]),
    ("robot.yaml", "len|gth: 1.10 m", ["**length** of `frame/tube_rectangular`", "in `m`"]),
    ("robot.yaml", "-250| mm".replace("-250", "70"), ["`0.07 m`", "Position x, y, z"]),
    ("robot.yaml", "frame.front|_left", ["a port of the kind `frame_clamp`", "x = 0.5", "`fl."]),
    ("robot.yaml", "mount: fra|me.front_left", ["**frame**: `frame/tube_rectangular`"]),
    (
        "robot.yaml",
        "type: assembly/steered|_drive",
        ["**assembly/steered_drive**", "- modules: steering"],
    ),
    ("module.yaml", "${size /| 2}", []),
    ("module.yaml", "defau|lt: 10 cm", ["Default value"]),
    ("module.yaml", "default: 10| cm", ["`0.1 m`"]),
    ("module.yaml", 'half: "${si|ze / 2}"', ["`0.05`"]),
    ("fleet.yaml", "ya|w: 90 deg", ["Rotation about the z axis", "in `rad`"]),
    ("fleet.yaml", "yaw: 90 d|eg", ["`1.5708 rad`"]),
    ("scenario.yaml", "fric|tion: 0.8", ["Friction coefficient"]),
    ("calibration.yaml", "rad|ius: 201 mm", ["Rolling radius in m"]),
    ("faults.yaml", "fault: no|ise", ["values: ", "`power_cut`"]),
]
TEXTS = {
    "robot.yaml": ROBOT,
    "module.yaml": POST,
    "fleet.yaml": "thorvaldc: 1\nname: f\nrobots: {a: {robot: robot.yaml, yaw: 90 deg}}\n",
    "scenario.yaml": "thorvaldc: 1\nscenario: s\nduration: 1 s\nworld: {friction: 0.8}\n",
    "calibration.yaml": "thorvaldc: 1\nrobot: cart\nwheels: {fl_wheel: {radius: 201 mm}}\n",
    "faults.yaml": "thorvaldc: 1\nfaults: [{fault: noise, at: 1 s}]\n",
}


@pytest.mark.parametrize(("name", "place", "expected"), HOVERS)
async def test_hover(editor: Editor, name: str, place: str, expected: list[str]) -> None:
    assert place.replace("|", "") in TEXTS[name]
    shown = await editor.hover(name, TEXTS[name].replace(place.replace("|", ""), place, 1))
    for text in expected:
        assert text in shown, shown


async def test_hover_of_a_module_shows_facts_of_the_robot(editor: Editor) -> None:
    uri = editor.open("robot.yaml", ROBOT)
    await editor.diagnostics_of(uri)
    editor.close(uri)
    uri = editor.open("robot.yaml", ROBOT)
    await editor.diagnostics_of(uri)
    shown = await editor.hover_at(uri, ROBOT.replace("  fl:", "  f|l:"))
    assert "mass: " in shown
    assert "wheel `fl_wheel`: driven and steered, radius 0.2 m" in shown
    assert "of the weight" in shown


async def test_hover_reads_own_modules_and_half_typed_documents(editor: Editor) -> None:
    editor.write("my modules/my/post/module.yaml", POST)
    text = WITH_POST.replace("front_center}", "front_center, params: {si|ze: 20 cm}}")
    assert "at least `1 mm` (0.001 m)" in await editor.hover("robot.yaml", text)
    text = WITH_POST.replace("  frame:", "  fr|ame:") + "  broken: {type: ["
    assert "`frame/tube_rectangular`" in await editor.hover("robot.yaml", text)


async def test_a_parameter_that_the_module_does_not_have(editor: Editor) -> None:
    text = ROBOT.replace("length: 1.10 m", "le|nght: 1.10 m")
    assert "|" in text
    assert await editor.hover("robot.yaml", text) == ""
