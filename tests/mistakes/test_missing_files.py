"""Paths that do not exist: the hint proposes the file that was meant, and the proposal is right."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.diagnostics.test_hints import apply
from tests.mistakes.test_mistakes import FILES, with_mistake, write
from thorvaldc.compiler.pipeline import compile_file

BOX = "parts/tools/box/module.yaml"
PATHS = [
    # file, right text, wrong text, code, proposed path
    ("fleet.yaml", "robot: cart.yaml", "robot: cart.yml", "TV324", "cart.yaml"),
    ("fleet.yaml", "robot: cart.yaml", "robot: Cart.yaml", "TV324", "cart.yaml"),
    ("fleet.yaml", "robot: cart.yaml", "robot: carts.yaml", "TV324", "cart.yaml"),
    ("fleet.yaml", "robot: cart.yaml", "robot: robots/cart.yaml", "TV324", "cart.yaml"),
    ("fleet.yaml", "robot: cart.yaml", "robot: cart", "TV324", "cart.yaml"),
    ("scenario.yaml", "robot: cart.yaml", r"robot: .\cart.yaml", "TV324", "cart.yaml"),
    ("robot.yaml", "calibration: calibration.yaml", "calibration: calib.yaml", "TV340", None),
    ("robot.yaml", "xacro: mast.xacro", "xacro: Mast.xacro", "TV740", "mast.xacro"),
    ("robot.yaml", "xacro: mast.xacro", "xacro: mast.urdf", "TV740", "mast.xacro"),
    ("robot.yaml", "xacro: mast.xacro", "xacro: urdf/mast.xacro", "TV740", "mast.xacro"),
    ("robot.yaml", "library: [parts]", "library: [part]", "TV701", "parts"),
    ("robot.yaml", "library: [parts]", "library: [./Parts]", "TV701", "parts"),
    ("robot.yaml", "library: [parts]", r"library: ['.\parts']", "TV701", "parts"),
    ("parts/tools/box/module.yaml", "{box: [", r"{mesh: {file: meshes\body.obj}} #", "TV730", ""),
    ("parts/tools/box/module.yaml", "{box: [", "{mesh: {file: meshes/Body.obj}} #", "TV730", ""),
    ("parts/tools/box/module.yaml", "{box: [", "{mesh: {file: body.obj}} #", "TV730", ""),
    ("parts/tools/box/module.yaml", "{box: [", "{mesh: {file: meshes/body.stl}} #", "TV730", ""),
]
BODY = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize(("file", "right", "wrong", "code", "proposed"), PATHS)
def test_the_meant_file_is_proposed(
    file: str,
    right: str,
    wrong: str,
    code: str,
    proposed: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert right in FILES[file]
    write(tmp_path, with_mistake(file, right, wrong, has_mast=False))
    write(tmp_path / "parts/tools/box", {"meshes/body.obj": BODY})
    monkeypatch.chdir(tmp_path)
    checked = file if "/" not in file else "robot.yaml"
    missing = [d for d in compile_file(checked).report.errors if d.code.number == code]
    assert len(missing) == 1
    path = {None: "calibration.yaml", "": "meshes/body.obj"}.get(proposed, proposed)
    assert missing[0].hint == f"did you mean `{path}`?"
    apply(missing[0].fixes[0])
    assert code not in [d.code.number for d in compile_file(checked).report]


def test_a_folder_with_many_files_is_not_searched_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, {"fleet.yaml": FILES["fleet.yaml"].replace("cart.yaml", "wagon.yaml")})
    for number in range(1000):
        (tmp_path / f"note_{number}.txt").touch()
    monkeypatch.chdir(tmp_path)
    missing = [d for d in compile_file("fleet.yaml").report if d.code.number == "TV324"]
    assert [d.hint for d in missing] == ["the path is relative to this file"] * len(missing) != []


@pytest.mark.parametrize("file", ["module.yml", "Module.yaml", "MODULE.YML"])
def test_a_module_file_with_another_name_is_named(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, with_mistake("robot.yaml", "name: picker", "name: picker", has_mast=False))
    (tmp_path / BOX).rename(tmp_path / BOX.replace("module.yaml", file))
    monkeypatch.chdir(tmp_path)
    (error,) = compile_file("robot.yaml").report.errors
    assert error.code.number == "TV301"
    assert error.hint == f"rename `parts/tools/box/{file}` to `module.yaml`"


def test_the_only_document_of_a_folder_is_proposed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = FILES["fleet.yaml"].replace("cart.yaml", "carts/")
    write(tmp_path, {"fleet.yaml": changed, "carts/cart.yaml": FILES["cart.yaml"]})
    monkeypatch.chdir(tmp_path)
    assert [d.hint for d in compile_file("fleet.yaml").report] == [
        "did you mean `carts/cart.yaml`?",
    ] * 2
    (tmp_path / "carts" / "other.yaml").touch()
    hints = {d.hint for d in compile_file("fleet.yaml").report}
    assert hints == {"this is a folder; name the file in it"}
