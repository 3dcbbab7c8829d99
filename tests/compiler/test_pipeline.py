"""Compilation of files: spans, hashes, fleets, reproducible outputs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.examples import FOLDER
from tests.workshop import CART, Workshop
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler import pipeline
from thorvaldc.compiler.pipeline import MODEL_FILE, compile_file, emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.model_json import from_json

ROOT = FOLDER.parent


def compiled(path: Path | str) -> Compilation:
    compilation = compile_file(path)
    assert compilation.model is not None, [d.message for d in compilation.report]
    return compilation


# -- spans ------------------------------------------------------------------------------


def test_reports_show_paths_as_the_user_gave_them(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = workshop.robot_file(CART.replace("fl: {type: t/leg", "fl: {type: t/lag"))
    monkeypatch.chdir(workshop.folder.parent)
    for path in (str(file), os.path.relpath(file), f"./{os.path.relpath(file)}"):
        (diagnostic,) = [
            d for d in compile_file(path).report if d.code.name == "module-type-unknown"
        ]
        assert diagnostic.span is not None
        assert Path(diagnostic.span.file) == Path(path)
        assert (diagnostic.span.line, diagnostic.span.column) == (6, 14)


def test_every_span_in_a_report_has_a_source_file(workshop: Workshop) -> None:
    workshop.module(
        "t/part", "links: {a: {}}\nports: {p: {kind: clamp, link: b}}\nmount: {kinds: [clamp]}\n"
    )
    compilation = workshop.compile(
        CART + "    part: {type: t/part, mount: body.front}\n"
        "    odd: {type: battery/enclosure, mount: body.front}"
    )
    places = {d.span.file for d in compilation.report if d.span}
    places |= {label.span.file for d in compilation.report for label in d.labels}
    assert len(places) >= 2
    for place in places:
        assert compilation.sources[place].is_file(), place


def test_diagnostics_of_backends_are_located(workshop: Workshop) -> None:
    workshop.write("xacro/x.xacro", "<robot name='x'><link name='a'/><gazebo/><gazebo/></robot>")
    for name in ("one", "two"):
        workshop.robot_file(CART, "extras: [{xacro: ../xacro/x.xacro}]\n", f"{name}/robot.yaml")
    fleet = workshop.write(
        "fleets/fleet.yaml",
        """
        thorvaldc: 1
        name: pair
        robots:
          a: {robot: ../one/robot.yaml}
          b: {robot: ../two/robot.yaml, xyz: [0, 5, 0]}
        """,
    )
    for file, folders in (
        (workshop.folder / "one/robot.yaml", ["one"]),
        (fleet, ["one", "two"]),
    ):
        compilation = compiled(file)
        assert compilation.model is not None
        report = Report()
        emit(compilation.model, ["mjcf"], report)
        (note, *_) = report
        assert note.message.endswith(": 2 x <gazebo>")
        places = [d.span.file for d in compilation.located(report) if d.span is not None]
        assert places == [str(workshop.folder / name / "robot.yaml") for name in folders]
        assert all(place in compilation.sources for place in places)


def test_spans_in_a_model_do_not_depend_on_its_folder(tmp_path: Path) -> None:
    models = []
    for name in ("here", "over there/deep"):
        workshop = Workshop(tmp_path / name)
        models.append(compiled(workshop.robot_file(CART)))
    assert models[0].model == models[1].model
    assert models[0].source_sha256 == models[1].source_sha256
    assert isinstance(models[0].model, Robot)
    assert {link.span.file for link in models[0].model.links} == {"robot.yaml"}


# -- hashes -----------------------------------------------------------------------------


def test_hash_depends_on_every_document_that_was_read(workshop: Workshop) -> None:
    text = CART + "    part: {type: t/block, mount: body.front}"
    first = compiled(workshop.robot_file(text)).source_sha256
    assert compiled(workshop.robot_file(text)).source_sha256 == first
    block = workshop.folder / "my_modules/t/block/module.yaml"
    block.write_text(block.read_text(encoding="utf-8") + "# more\n", encoding="utf-8")
    second = compiled(workshop.robot_file(text)).source_sha256
    workshop.write("my_modules/palette.yaml", 'mine: "#000000"\n')
    third = compiled(workshop.robot_file(text)).source_sha256
    fourth = compiled(workshop.robot_file(text + "\n    # robot")).source_sha256
    assert len({first, second, third, fourth}) == 4
    # Modules that the robot does not use do not change the hash.
    workshop.module("t/other", "links: {a: {}}")
    assert compiled(workshop.robot_file(text + "\n    # robot")).source_sha256 == fourth


# -- unusual names ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["with spaces", "måneåker", "農場", "a'b\"c", "-o", "%s {x} ${y}"])
def test_unusual_folder_names(tmp_path: Path, name: str) -> None:
    """The output does not depend on the folder, so it does not contain the name of the folder."""
    assert outputs_in(tmp_path / name) == outputs_in(tmp_path / "usual")


def outputs_in(folder: Path) -> dict[str, bytes]:
    workshop = Workshop(folder)
    workshop.write("my_modules/t/part/a mesh ü.obj", MESH)
    workshop.module(
        "t/part",
        'mount: {kinds: [clamp]}\nlinks: {a: {parts: [{shape: {mesh: {file: "a mesh ü.obj"}}, '
        'source: "chosen: for a test"}]}}\n',
    )
    file = workshop.robot_file(CART + "    part: {type: t/part, mount: body.front}")
    compilation = compiled(file)
    assert isinstance(compilation.model, Robot)
    assert compilation.model.meshes[0].name.isascii()
    return emit(compilation.model, DEFAULT_TARGETS, Report())


MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_descriptions_may_be_in_any_alphabet(workshop: Workshop) -> None:
    words = 'Трактор für 水稲 – «çà» \N{TRACTOR} & <tag> "q"'
    robot = workshop.robot(CART, f"description: '{words}'\n")
    assert robot.description == words
    files = emit(robot, DEFAULT_TARGETS, Report())
    again = from_json(files[MODEL_FILE].decode())
    assert isinstance(again, Robot)
    assert again.description == words


@pytest.mark.parametrize("bom", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_line_ends_and_byte_order_marks_do_not_matter(
    workshop: Workshop, bom: bytes, end: bytes
) -> None:
    file = workshop.robot_file(CART)
    expected = compiled(file).model
    file.write_bytes(bom + file.read_bytes().replace(b"\n", end))
    assert compiled(file).model == expected


# -- outputs ----------------------------------------------------------------------------

SCRIPT = """
import hashlib, sys
from thorvaldc.diagnostics import Report
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit
for path in sys.argv[1:]:
    done = compile_file(path)
    report = Report()
    files = emit(done.model, DEFAULT_TARGETS, report)
    for name, data in files.items():
        print(name, hashlib.sha256(data).hexdigest())
    for diagnostic in [*done.report, *report]:
        print(diagnostic.span, diagnostic.message)
    print(done.source_sha256)
"""


@pytest.mark.slow
def test_output_does_not_depend_on_the_hash_seed(workshop: Workshop) -> None:
    mine = str(workshop.robot_file(CART))
    examples = [
        str(FOLDER / name) for name in ("4wd4ws_wide/robot.yaml", "fleet_of_four/fleet.yaml")
    ]
    outputs = []
    for seed in ("0", "1", "7"):
        compilation = subprocess.run(
            [sys.executable, "-c", SCRIPT, mine, *examples],
            check=True,
            capture_output=True,
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)},
        )
        outputs.append(compilation.stdout)
    assert outputs[0] == outputs[1] == outputs[2]
    assert len(outputs[0].splitlines()) > 20


def test_compilations_do_not_affect_each_other(workshop: Workshop) -> None:
    example = FOLDER / "4wd4ws_wide/robot.yaml"
    alone = emit(compiled(example).model, DEFAULT_TARGETS, Report())  # type: ignore[arg-type]
    workshop.write("my_modules/palette.yaml", 'tyre: "#ff0000"\n')
    for head in ("", "driver: {rate: 10}\n", "namespace: other\n"):
        workshop.compile(CART.replace("t/leg", "caster/fixed"), head)
    workshop.compile("body: {type: none}")
    assert emit(compiled(example).model, DEFAULT_TARGETS, Report()) == alone  # type: ignore[arg-type]


def test_emit_returns_the_model_and_each_target_once(workshop: Workshop) -> None:
    robot = workshop.robot(CART)
    files = emit(robot, ["urdf", "urdf"], Report())
    assert list(files) == [MODEL_FILE, "urdf/robot.urdf"]
    assert from_json(files[MODEL_FILE].decode()) == robot
    assert list(emit(robot, [], Report())) == [MODEL_FILE]
    with pytest.raises(KeyError):
        emit(robot, ["nothing"], Report())


def test_no_model_with_errors(workshop: Workshop) -> None:
    compilation = workshop.compile(CART + "    part: {type: t/block}")
    assert compilation.report.has_errors
    assert compilation.model is None
    assert compilation.source_sha256 != ""


def test_a_file_that_disappears_during_the_compilation_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = tmp_path / "robot.yaml"
    shutil.copy(FOLDER / "4wd4ws_wide" / "robot.yaml", robot)
    check_robot = pipeline.check_robot

    def removed_before(*arguments: Any) -> None:
        robot.unlink()
        check_robot(*arguments)

    monkeypatch.setattr(pipeline, "check_robot", removed_before)
    compilation = compile_file(robot)
    (error,) = compilation.report.errors
    assert error.code.name == "file-unreadable"
    assert f"`{robot}` was read, but cannot be read again" in error.message
    assert compilation.model is None
