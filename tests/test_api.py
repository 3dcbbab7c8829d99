"""The public names of `import thorvaldc`."""

from __future__ import annotations

import ast
import inspect
import pickle
import pydoc
import subprocess
import sys
import traceback
from importlib import import_module
from pathlib import Path

import pytest

import thorvaldc

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
EXAMPLE = EXAMPLES / "4wd4ws_slim/robot.yaml"


def printed(script: str) -> str:
    """Runs a script in a new process and returns what it prints."""
    return subprocess.run(
        [sys.executable, "-c", script],
        check=True,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": ":".join(sys.path)},
    ).stdout


def test_compile_emit_and_simulate() -> None:
    compilation = thorvaldc.compile(EXAMPLE)
    files = thorvaldc.emit(compilation.model, ["mjcf"], compilation.report)
    result = thorvaldc.Simulation(compilation.model, files).run(0.5, _forward())
    assert result.robots[0].path_true > 0.0
    assert pickle.loads(pickle.dumps(result)) == result  # as a process pool passes it on


def _forward() -> object:
    from thorvaldc.runtime.se2 import Twist

    return Twist(0.5, 0.0, 0.0)


def test_all_public_names_exist() -> None:
    assert all(getattr(thorvaldc, name) is not None for name in thorvaldc.__all__)
    with pytest.raises(AttributeError, match="unknown_name"):
        thorvaldc.unknown_name  # noqa: B018
    with pytest.raises(AttributeError, match="did you mean 'load'"):
        thorvaldc.laod  # noqa: B018


def test_every_public_name_has_a_docstring() -> None:
    for name in set(thorvaldc.__all__) - {"__version__"}:
        value = getattr(thorvaldc, name)
        assert value.__doc__, name
        if not isinstance(value, type):
            continue
        for member, attribute in vars(value).items():
            if not member.startswith("_") and (callable(attribute) or type(attribute) is property):
                assert inspect.getdoc(getattr(value, member)), f"{name}.{member}"


def test_type_checkers_see_the_names_of_the_table() -> None:
    """The imports below ``TYPE_CHECKING`` and the table of the first uses say the same."""
    tree = ast.parse(Path(thorvaldc.__file__).read_text(encoding="utf-8"))
    imported = {
        alias.asname or alias.name: (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("thorvaldc.")
        for alias in node.names
        if alias.name != "nearest"
    }
    assert set(imported) == set(thorvaldc.__all__) - {"__version__"}
    for name, (module, attribute) in imported.items():
        assert getattr(thorvaldc, name) is getattr(import_module(module or ""), attribute), name


def test_names_are_listed_before_their_first_use() -> None:
    script = (
        "import sys, thorvaldc; print(*dir(thorvaldc)); print('thorvaldc.model' in sys.modules)"
    )
    listed, is_loaded = printed(script).splitlines()
    assert set(thorvaldc.__all__) <= set(listed.split())
    assert is_loaded == "False"


def test_help_shows_every_name() -> None:
    shown = pydoc.plain(pydoc.render_doc(thorvaldc))
    for name in set(thorvaldc.__all__) - {"__version__"}:
        assert name in shown


def test_load_gives_a_robot_or_all_errors(tmp_path: Path) -> None:
    assert thorvaldc.load(EXAMPLE).name == "thorvald_4wd4ws_slim"
    file = tmp_path / "robot.yaml"
    file.write_text("thorvaldc: 1\nname: x\nmoduls: {}\ndriver: {rate: 5 kg}\n", encoding="utf-8")
    with pytest.raises(thorvaldc.CompileError) as caught:
        thorvaldc.load(str(file))
    report = thorvaldc.compile(file).report
    assert list(caught.value.diagnostics) == report.sorted()
    assert {d.code.number for d in caught.value.errors} >= {"TV201", "TV211"}
    assert f"{file}:3:1: error[TV201] unknown-key" in str(caught.value)
    assert "3 | moduls: {}" in str(caught.value)  # the excerpt
    copy = pickle.loads(pickle.dumps(caught.value))  # as a process pool passes it on
    assert (str(copy), copy.diagnostics) == (str(caught.value), caught.value.diagnostics)


def test_load_reads_the_model_of_a_build(tmp_path: Path) -> None:
    robot = thorvaldc.load(EXAMPLE)
    (tmp_path / "model.json").write_bytes(thorvaldc.emit(robot, [])["model.json"])
    assert thorvaldc.load(tmp_path / "model.json") == robot
    (tmp_path / "model.json").write_text("{}", encoding="utf-8")
    with pytest.raises(thorvaldc.CompileError, match="TV809"):
        thorvaldc.load(tmp_path / "model.json")


def test_load_says_which_function_reads_a_fleet_and_which_a_robot() -> None:
    fleet = EXAMPLES / "fleet_of_four/fleet.yaml"
    assert len(thorvaldc.load_fleet(fleet).placements) == 4
    with pytest.raises(thorvaldc.CompileError, match=r"got a fleet\n.*load_fleet\(\)"):
        thorvaldc.load(fleet)
    with pytest.raises(thorvaldc.CompileError, match=r"got a robot\n.*load\(\)"):
        thorvaldc.load_fleet(EXAMPLE)


def test_a_missing_file_and_a_wrong_library() -> None:
    with pytest.raises(thorvaldc.CompileError, match="does not exist"):
        thorvaldc.load("nowhere.yaml")
    with pytest.raises(TypeError, match="expected a list of folders, got 'modules'"):
        thorvaldc.compile(EXAMPLE, library="modules")


def test_mistakes_name_what_is_known() -> None:
    robot = thorvaldc.load(EXAMPLE)
    with pytest.raises(KeyError, match=r"unknown target `urfd`; did you mean `urdf`\? .*mjcf"):
        thorvaldc.emit(robot, ["urfd"])
    with pytest.raises(TypeError, match=r"a list of names such as \['urdf'\], got 'urdf'"):
        thorvaldc.emit(robot, "urdf")
    with pytest.raises(TypeError, match="got None: the file has errors"):
        thorvaldc.emit(None, ["urdf"])
    with pytest.raises(thorvaldc.DiagnosticError, match="no parameter set `rial`") as caught:
        thorvaldc.Simulation(
            thorvaldc.load(EXAMPLES / "2wd0ws_greenhouse/robot.yaml"), parameters="rial"
        )
    assert "did you mean `rail`?" in "".join(traceback.format_exception(caught.value))


def test_texts_of_the_main_objects_are_short() -> None:
    robot = thorvaldc.load(EXAMPLE)
    fleet = thorvaldc.load_fleet(EXAMPLES / "fleet_of_four/fleet.yaml")
    compilation = thorvaldc.compile(EXAMPLES / "nowhere.yaml")
    base = thorvaldc.SimBase(robot)
    texts = {
        "<Robot thorvald_4wd4ws_slim: 4 wheels, 150.0 kg>": robot,
        "<Wheel fl_wheel: driven, steered, radius 0.2 m>": robot.wheels[0],
        "<Link base_link: no mass>": robot.links[0],
        "<Fleet fleet_of_four: 4 robots>": fleet,
        "<Compilation: no model, 1 error, 0 warnings>": compilation,
        "<Report: 1 error, 0 warnings>": compilation.report,
        "<Simulation of tall, slim, wide and 1 more with ideal joints>": thorvaldc.Simulation(
            fleet
        ),
        "<SimBase: 4 wheels, 0 s>": base,
        "<BaseDriver of thorvald_4wd4ws_slim: idle>": thorvaldc.BaseDriver(robot, base),
    }
    assert {repr(value): value for value in texts.values()} == texts
    assert repr(next(iter(compilation.report))).startswith("<Diagnostic TV901 file-not-found at ")
    assert robot == thorvaldc.load(EXAMPLE)
    assert robot != fleet.placements[1].robot  # another name space


def test_the_import_loads_no_other_module() -> None:
    script = "import sys, thorvaldc; print([m for m in sys.modules if m.startswith('thorvaldc.')])"
    assert printed(script) == "[]\n"
