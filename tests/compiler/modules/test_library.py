"""Library folders: their priority, and caching between compilations."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from tests.workshop import CART, TETRAHEDRON, Workshop
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY, Library
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.source.input_file import read_bytes, unsaved_texts
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.renderers import render_text
from thorvaldc.model import Robot

SOURCE = 'source: "chosen: for a test"'
ASKED = Node("", Span("robot.yaml", 3))
BLOCK = f"""
thorvaldc: 1
description: A block.
mount: {{kinds: [clamp], link: box}}
links: {{box: {{parts: [{{shape: {{sphere: {{radius: 0.1}}}}, mass: %s, {SOURCE}}}]}}}}
"""


def folder(path: Path, *types: str, mass: str = "1 kg") -> Path:
    for name in types:
        file = path / name / "module.yaml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(BLOCK % mass, encoding="utf-8")
    return path


def test_type_name_is_the_folder_path(tmp_path: Path) -> None:
    mine = folder(tmp_path / "mine", "a/one", "a/b/two", "flat")
    library = Library([(mine, "mine")])
    assert {"a/one", "a/b/two", "flat", "drive/standard"} <= set(library.names())
    assert library.names_in(mine) == ["a/b/two", "a/one", "flat"]
    report = Report()
    module = library.load("a/b/two", ASKED, report)
    assert module is not None
    assert (module.name, module.category, module.display) == (
        "a/b/two",
        "a",
        "mine/a/b/two/module.yaml",
    )
    assert library.exists("flat")
    assert not library.exists("flat/one")
    assert list(report) == []


def test_a_module_with_another_document_has_values_of_its_own() -> None:
    library = Library([])
    module = library.load("drive/standard", ASKED, Report())
    assert module is not None
    text = f"params: {{mass: {{quantity: mass, default: %d kg, description: A., {SOURCE}}}}}"
    for mass in range(50):  # a new document often has the address of one that was deleted
        document = read_text((text % mass).encode(), "module.yaml", Report())
        assert document is not None
        changed = replace(module, document=document)
        assert Scope(changed, {}, library, Report(), None).parameter_values() == (mass,)


def test_priority_of_library_folders(tmp_path: Path) -> None:
    first = folder(tmp_path / "first", "drive/standard", "x/y", mass="2 kg")
    second = folder(tmp_path / "second", "x/y", "x/z", mass="3 kg")
    library = Library([(first, "first"), (second, "second")])
    shown = {}
    for name in ("drive/standard", "x/y", "x/z", "steering/standard"):
        module = library.load(name, ASKED, Report())
        assert module is not None
        shown[name] = module.display.split("/")[0]
    assert shown == {
        "drive/standard": "first",
        "x/y": "first",
        "x/z": "second",
        "steering/standard": BUILTIN_LIBRARY,
    }


def test_built_in_type_is_used_again_without_that_of_the_user(workshop: Workshop) -> None:
    cart = CART.replace("t/plate", "frame/tube_rectangular").replace("t/leg", "caster/fixed")
    ours = workshop.robot(cart).inertial.mass
    workshop.module(
        "caster/fixed",
        f"""
        mount: {{kinds: [frame_clamp], link: post}}
        links:
          post: {{}}
          tyre: {{parts: [{{shape: {{sphere: {{radius: 0.1}}}}, mass: 1 kg, {SOURCE}}}]}}
        joints:
          axle: {{type: continuous, parent: post, child: tyre, xyz: [0, 0, -0.4], axis: [0, 1, 0]}}
        wheel: {{link: tyre, radius: 0.1, width: 0.1, {SOURCE}}}
        """,
    )
    theirs = workshop.robot(cart)
    assert [w.radius for w in theirs.wheels] == [0.1] * 4
    (workshop.folder / "my_modules/caster/fixed/module.yaml").unlink()
    assert workshop.robot(cart).inertial.mass == ours


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../drive",
        "drive/../drive/standard",
        "/etc",
        "drive//standard",
        "drive/",
        "a\\b",
        "drive/standard/module.yaml",
        "x" * 5000,
        "a\0b",
        "Drive/Standard",
    ],
)
def test_invalid_type_names(name: str) -> None:
    report = Report()
    assert Library().load(name, ASKED, report) is None
    (diagnostic,) = report
    assert diagnostic.code.name == "module-type-unknown"
    assert diagnostic.span == ASKED.span


def test_a_misspelt_name_has_a_hint(tmp_path: Path) -> None:
    report = Report()
    Library([(folder(tmp_path, "sprayer/boom"), "mine")]).load("sprayer/bom", ASKED, report)
    assert "`sprayer/boom`" in str(next(iter(report)).hint)


def test_a_module_that_changed_is_read_again(workshop: Workshop) -> None:
    light = workshop.robot(CART + "    part: {type: t/block, mount: body.front}")
    file = workshop.folder / "my_modules/t/block/module.yaml"
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("default: 10 kg", "default: 25 kg"), encoding="utf-8")
    heavy = workshop.robot(CART + "    part: {type: t/block, mount: body.front}")
    assert heavy.inertial.mass == light.inertial.mass + 15


def test_error_in_a_module_is_reported_at_every_compilation(workshop: Workshop) -> None:
    workshop.module("t/part", "links: {a: {}}\nnonsense: 3\n")
    for _ in range(2):
        diagnostics = workshop.diagnostics(CART + "    part: {type: t/part, mount: body.front}")
        assert [d.code.name for d in diagnostics if d.severity.value == "error"] == ["unknown-key"]


def test_a_broken_module_that_is_not_used_is_not_read(workshop: Workshop) -> None:
    workshop.module("t/part", "nonsense: [")
    workshop.robot(CART)


def test_folders_of_the_caller_come_after_those_of_the_file(tmp_path: Path) -> None:
    outside = folder(tmp_path / "outside", "x/y", "x/z", mass="3 kg")
    workshop = Workshop(tmp_path / "robot")
    folder(workshop.folder / "my_modules", "x/y", mass="2 kg")
    file = workshop.robot_file(
        CART + "    y: {type: x/y, mount: body.front}\n    z: {type: x/z, mount: body.front}"
    )
    model = compile_file(file, library=[outside]).model
    assert isinstance(model, Robot)
    masses = [model.link(name).inertial for name in ("y_box", "z_box")]
    assert [m.mass for m in masses if m is not None] == [2.0, 3.0]


def test_relative_library_folder_does_not_depend_on_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop = Workshop(tmp_path / "deep" / "down")
    workshop.write("my_modules/t/part/a.obj", TETRAHEDRON)
    workshop.module(
        "t/part",
        f"""
        params:
          n: {{type: integer, description: Of it., default: 0, {SOURCE}}}
        mount: {{kinds: [clamp]}}
        links: {{a: {{parts: [{{shape: {{mesh: {{file: a.obj}}}}, {SOURCE}}}]}}}}
        """,
    )
    cart = CART + "    part: {type: t/part, mount: body.front, params: {n: %d}}"
    for n, start in enumerate((tmp_path, tmp_path / "deep", workshop.folder)):
        workshop.robot_file(cart % n)
        monkeypatch.chdir(start)
        compilation = compile_file(os.path.relpath(workshop.folder / "robot.yaml"))
        assert isinstance(compilation.model, Robot), list(compilation.report)


@pytest.mark.parametrize("text", ["- red", "tyre: [1, 2]", "tyre: 3", "tyre: ["])
def test_error_in_a_palette_has_its_line(workshop: Workshop, text: str) -> None:
    workshop.write("my_modules/palette.yaml", text + "\n")
    for _ in range(2):
        (diagnostic,) = [d for d in workshop.diagnostics(CART) if d.severity.value == "error"]
        assert diagnostic.span is not None
        assert diagnostic.span.file == str(workshop.folder / "my_modules/palette.yaml")


def test_built_in_library_has_no_errors() -> None:
    library, report = Library(), Report()
    for name in library.names():
        assert library.load(name, ASKED, report) is not None
    assert list(report) == []
    assert len(library.palette()) > 10


def test_an_unsaved_module_replaces_the_file_on_the_disk(tmp_path: Path) -> None:
    mine = folder(tmp_path / "mine", "a/one", mass="1 kg")
    real_path = os.path.realpath(mine / "a/one/module.yaml")
    links = []
    for text in (None, BLOCK % "2 kg", BLOCK % "3 kg", None):
        with unsaved_texts({} if text is None else {real_path: text.encode()}):
            module = Library([(mine, "mine")]).load("a/one", ASKED, Report())
        assert module is not None
        links.append(str(module.document.get("links")))
    assert links[0] == links[3]
    assert ["kg" in text and text.count("2 kg") for text in links] == [0, 1, 0, 0]
    assert read_bytes(Path(real_path), "x", Report(), limit=10**6) == (BLOCK % "1 kg").encode()


def test_a_library_beside_the_robot_file_that_it_does_not_name(tmp_path: Path) -> None:
    module = tmp_path / "modules" / "sensor" / "eye" / "module.yaml"
    module.parent.mkdir(parents=True)
    module.write_text("thorvaldc: 1\n")
    robot = tmp_path / "robot.yaml"
    robot.write_text("thorvaldc: 1\nname: r\nmodules:\n  eye: {type: sensor/eye}\n")
    hint = compile_file(robot).report.errors[0].hint
    assert hint == "`library: [modules]` in this file adds modules/sensor/eye/module.yaml"


SECRET = "root:x:0:0:secret"


@pytest.mark.parametrize("file", ["m/frame/x/module.yaml", "m/palette.yaml", "robot.lock.yaml"])
@pytest.mark.parametrize("leads_outside", [True, False])
def test_a_link_to_a_file_outside_of_its_folder_is_not_read(
    tmp_path: Path, file: str, leads_outside: bool
) -> None:
    home = tmp_path / "home"
    (home / "m/frame/x").mkdir(parents=True)
    secret = tmp_path / "secret" if leads_outside else (home / file).with_name("inside")
    secret.write_text(SECRET)
    (home / file).symlink_to(secret)
    robot = home / "robot.yaml"
    robot.write_text("thorvaldc: 1\nname: r\nlibrary: [m]\nmodules: {a: {type: frame/x}}\n")
    compilation = compile_file(robot)
    text = render_text(compilation.report, compilation.sources)
    refused = [d for d in compilation.report if d.code.name == "file-unreadable"]
    assert len(refused) == leads_outside
    assert (SECRET in text) == (not leads_outside)
    assert all("is a link to a file outside of its folder" in d.message for d in refused)


@pytest.mark.parametrize("name", ["../../../secret.obj", "link.obj", "../../shared.obj"])
def test_meshes_of_a_module_lie_in_its_library_folder(tmp_path: Path, name: str) -> None:
    library = folder(tmp_path / "home/m", "frame/x")
    for path in (tmp_path / "home/secret.obj", library / "shared.obj"):
        path.write_text(TETRAHEDRON, encoding="utf-8")
    (library / "frame/x/link.obj").symlink_to(tmp_path / "home/secret.obj")
    module = library / "frame/x/module.yaml"
    mesh = BLOCK.replace("sphere: {radius: 0.1}", f"mesh: {{file: {name}}}") % "1 kg"
    module.write_text(mesh, encoding="utf-8")
    robot = tmp_path / "home/robot.yaml"
    robot.write_text("thorvaldc: 1\nname: r\nlibrary: [m]\nmodules: {a: {type: frame/x}}\n")
    messages = [d.message for d in compile_file(robot).report if d.code.name == "mesh-missing"]
    outside = f"mesh file `{name}` cannot be read: it is outside of the library folder"
    assert messages == ([] if "shared" in name else [outside])
