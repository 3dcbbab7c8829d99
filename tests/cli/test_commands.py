"""The output of each command on stdout and stderr, and its exit status."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command, needs_tools
from thorvaldc import backends
from thorvaldc.compiler import sandbox
from thorvaldc.diagnostics import CODES


@needs_tools
def test_help_names_every_command(thorvaldc: Command) -> None:
    output = thorvaldc("--help")
    assert output.status == 0
    for word in [
        "check",
        "build",
        "sim",
        "render",
        "view",
        "import",
        "new",
        "targets",
        "schema",
        "explain",
        "modules",
        "audit",
    ]:
        assert re.search(rf"^  {word} ", output.out, re.M), word
    assert thorvaldc("-h") == output


def test_the_version_is_shown_without_the_import_of_a_command() -> None:
    script = (
        "import sys; sys.argv = ['thorvaldc', '--version']\n"
        "from thorvaldc.cli.main import run_command; run_command()\n"
        "print(*[m for m in sys.modules if m.startswith(('thorvaldc.tools', 'thorvaldc.model'))])"
    )
    command = [sys.executable, "-c", script]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[1:] == [""]


def test_version(thorvaldc: Command) -> None:
    assert re.fullmatch(r"thorvaldc \d+\.\d+\.\d+( \(compiled\))?\n", thorvaldc("--version").out)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["buidl", "x"], "Did you mean 'build'"),
        (["check"], "Missing argument 'FILE"),
        (["check", "good.yaml", "--nope"], "No such option: --nope"),
        (["check", "good.yaml", "--format", "xml"], "'xml' is none of text, json, github, sarif"),
        (
            ["build", "good.yaml", "--target", "urdf,mjfc"],
            "unknown target `mjfc`; did you mean `mjcf`?",
        ),
        (["build", "good.yaml", "--target", ","], "names no target"),
        (["check", "good.yaml", "--library", "nowhere"], "no folder 'nowhere'"),
        (["sim", "good.yaml", "--duration", "5 m"], "'5 m'"),
        (["sim", "good.yaml", "--duration", "-1"], "not between"),
        (["new", "Bad Name"], "no name for a robot"),
        (["new", "my-robot"], "did you mean `my_robot`?"),
        (["new"], "give the robot a name: thorvaldc new my_robot"),
        (["new", "mine", "--preset", "3wd"], "1wd1ws, 2wd0ws, 4wd4ws"),
        (["explain", "TV99999"], "no code `TV99999`"),
        (["explain", "can-id-duplicat"], "did you mean `can-id-duplicate`?"),
        (["schema", "car"], "none of robot, module, fleet"),
        (["modules", "show", "drive/standart"], "did you mean 'drive/standard'?"),
        (["modules", "check", "nowhere"], "no folder 'nowhere'"),
    ],
)
def test_usage_is_2_and_one_error(thorvaldc: Command, arguments: list[str], expected: str) -> None:
    status, out, err = thorvaldc(*arguments)
    assert (status, out) == (2, "")
    assert expected in err
    assert len(err.splitlines()) <= 4
    assert not Path("build").exists()


# -- check ------------------------------------------------------------------------------


def test_check_of_a_good_file(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("check", "good.yaml")
    assert (status, err) == (0, "")
    assert re.fullmatch(r"good\.yaml: good, 4 wheels \(4 driven, 4 steered\), \d+\.\d kg\n", out)


def test_check_names_the_missing_limits(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sandbox, "missing_limits", ["not supported: RLIMIT_AS"])
    assert "not supported: RLIMIT_AS" in thorvaldc("check", "good.yaml").err
    assert "RLIMIT_AS" not in thorvaldc("check", "good.yaml", "--format", "json").err


def test_check_reports_all_errors_on_stdout(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("check", "good.yaml", "bad.yaml")
    assert (status, err) == (1, "")
    assert "bad.yaml:2:7" in out
    assert re.search(r"^bad\.yaml:6:\d+: error\[TV\d+\]", out, re.M)
    assert "errors in 2 files" in out.splitlines()[-1]
    assert "\033" not in out


def test_warnings_are_no_errors_unless_strict(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("check", "shaky.yaml")
    assert status == 0
    assert "1 warning in 1 file" in out
    assert thorvaldc("check", "--strict", "shaky.yaml").status == 1


@pytest.mark.parametrize(
    "name", ["missing.yaml", ".", "empty.yaml", "binary.yaml", "list.yaml", "good.yaml/x"]
)
def test_a_file_that_is_no_robot_is_one_error(thorvaldc: Command, name: str) -> None:
    Path("empty.yaml").write_text("")
    Path("binary.yaml").write_bytes(b"\x7fELF\x00\xff\xfe")
    Path("list.yaml").write_text("[1, 2]\n")
    status, out, err = thorvaldc("check", name)
    assert (status, err) == (1, "")
    assert out.rstrip().splitlines()[-1].startswith("1 error in 1 file")


def test_check_as_json_is_one_document(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("check", "bad.yaml", "good.yaml", "--format", "json")
    assert (status, err) == (1, "")
    document = json.loads(out)["diagnostics"]
    assert len(document) >= 2
    assert {"code", "message"} <= document[0].keys()
    good = json.loads(thorvaldc("check", "good.yaml", "--format", "json").out)
    assert good["diagnostics"] == []


def test_check_for_github_is_a_line_per_diagnostic(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("check", "bad.yaml", "--format", "github")
    assert status == 1
    assert all(line.startswith("::error ") for line in out.splitlines())
    assert "file=bad.yaml,line=2" in out


def test_check_as_sarif(thorvaldc: Command) -> None:
    document = json.loads(thorvaldc("check", "bad.yaml", "--format", "sarif").out)
    assert document["version"] == "2.1.0"
    assert len(document["runs"][0]["results"]) >= 2


# -- build ------------------------------------------------------------------------------


def test_build_writes_a_folder_with_the_name_of_the_robot(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("build", "good.yaml")
    assert (status, err) == (0, "")
    assert re.fullmatch(r"build/good: \d+ files \(urdf, mjcf, ros2, can\)\n", out)
    assert Path("build/good/manifest.json").is_file()
    for folder in ("urdf", "mjcf", "ros2", "can"):
        assert Path("build/good", folder).is_dir()


def test_build_of_one_file_writes_the_named_folder(thorvaldc: Command) -> None:
    thorvaldc("build", "good.yaml", "-o", "there", "--target", "can")
    assert sorted(p.name for p in Path("there").iterdir()) == [
        "can",
        "manifest.json",
        "model.json",
    ]


def test_build_of_several_makes_a_folder_for_each(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("build", "good.yaml", "shaky.yaml", "-o", "there")
    assert status == 0
    assert sorted(p.name for p in Path("there").iterdir()) == ["good", "shaky"]
    assert len(out.splitlines()) == 2


def test_two_robots_of_one_name_do_not_overwrite_each_other(thorvaldc: Command) -> None:
    Path("other.yaml").write_text(GOOD)
    status, _, err = thorvaldc("build", "good.yaml", "other.yaml")
    assert status == 2
    assert "good.yaml and other.yaml both go to build/good" in err


def test_a_build_with_errors_writes_nothing_and_keeps_the_last(thorvaldc: Command) -> None:
    thorvaldc("build", "good.yaml", "-o", "out")
    manifest_before = Path("out/manifest.json").read_bytes()
    status, out, err = thorvaldc("build", "bad.yaml", "-o", "out")
    assert (status, out) == (1, "")
    assert "bad.yaml:2:7" in err
    assert Path("out/manifest.json").read_bytes() == manifest_before


def test_files_without_errors_are_built(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("build", "bad.yaml", "good.yaml")
    assert status == 1
    assert out.startswith("build/good: ")


def test_build_as_json_lists_the_written_files(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("build", "good.yaml", "--format", "json")
    assert (status, err) == (0, "")
    (built,) = json.loads(out)["builds"]
    assert built["folder"] == "build/good"
    assert "urdf/robot.urdf" in built["files"]


@pytest.mark.parametrize("folder", ["good.yaml", "good.yaml/deeper", "/proc/nowhere/x"])
def test_a_folder_that_cannot_be_written_is_3_and_one_line(thorvaldc: Command, folder: str) -> None:
    status, out, err = thorvaldc("build", "good.yaml", "-o", folder)
    assert (status, out) == (3, "")
    assert err.startswith(f"error: cannot write {folder}: ")
    assert len(err.splitlines()) == 1


def test_a_folder_with_other_files_is_refused(thorvaldc: Command) -> None:
    status, _, err = thorvaldc("build", "good.yaml", "-o", ".")
    assert status == 3
    assert "will not write into the current folder" in err
    assert len(err.splitlines()) == 1


BUILD = """
import sys
from thorvaldc.cli.main import run
sys.argv = ["thorvaldc", "build", sys.argv[1], "-o", sys.argv[2], *sys.argv[3:]]
run()
"""


def test_output_is_the_same_bytes_everywhere(thorvaldc: Command, tmp_path: Path) -> None:
    """Builds in two folders, with two hash seeds and two spellings of the path."""
    trees = []
    for seed, where in (("1", "a"), ("4242", "b/deeper")):
        folder = tmp_path / where
        folder.mkdir(parents=True)
        (folder / "good.yaml").write_text(GOOD)
        name = "good.yaml" if where == "a" else str(folder / "good.yaml")
        subprocess.run(
            [sys.executable, "-c", BUILD, name, str(folder / "out")],
            cwd=folder if where == "a" else tmp_path,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": ":".join(sys.path), "TZ": f"UTC{seed[0]}"},
            check=True,
            stdout=subprocess.DEVNULL,
        )
        out = folder / "out"
        trees.append({p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()})
    assert trees[0].keys() == trees[1].keys()
    assert [p for p in trees[0] if trees[0][p] != trees[1][p]] == []
    assert not any(str(tmp_path).encode() in data for data in trees[0].values())


@pytest.mark.parametrize("targets", [(), ("--target", "urdf,mjcf,can")])
def test_a_build_loads_no_heavy_package(thorvaldc: Command, targets: tuple[str, ...]) -> None:
    """Only the ROS 2 package, one of the targets without an option, is made with jinja2."""
    heavy = ["numpy", "trimesh", "xacro", "mujoco", "can", "rich", "pydantic", "scipy"]
    heavy += ["jinja2"] if targets else []
    script = BUILD.replace(
        "run()\n",
        "try:\n    run()\nfinally:\n"
        f"    print([name for name in {heavy} if name in sys.modules])\n",
    )
    process = subprocess.run(
        [sys.executable, "-c", script, "good.yaml", "out", *targets],
        check=True,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": ":".join(sys.path)},
    )
    assert process.stdout.splitlines()[-1] == "[]"


# -- the rest -----------------------------------------------------------------------------


def test_sim_prints_a_table(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("sim", "good.yaml", "--duration", "1", "--twist", "0.5,0,0")
    assert (status, err) == (0, "")
    assert len(out.splitlines()) == 2
    assert out.splitlines()[1].startswith("good ")


def test_sim_by_a_parameter_set(thorvaldc: Command) -> None:
    examples = Path(__file__).parent.parent.parent / "examples"
    file = str(shutil.copy(examples / "2wd0ws_greenhouse/robot.yaml", "greenhouse.yaml"))
    output = thorvaldc(
        "sim", file, "--ideal", "--twist", "1,0,0", "--duration", "3", "--parameters", "rail"
    )
    assert output.status == 0
    # The set limits the speed to 0.4 m/s and the ramp to 1.08 m/s^2.
    assert "limited to (0.4 m/s, 0 m/s, 0 rad/s) by max_linear_velocity" in output.err
    assert re.search(r" 1\.1[0-9]+ m ", output.out)
    output = thorvaldc("sim", file, "--ideal", "--twist", "1,0,0", "--parameters", "rial")
    assert output.status == 1
    assert "parameter-set-unknown" in output.err
    assert "did you mean `rail`?" in output.err


def test_sim_as_json(thorvaldc: Command) -> None:
    status, out, err = thorvaldc(
        *("sim", "good.yaml", "--duration", "2 s", "--twist", "-0.5,0,0.2", "--json")
    )
    assert (status, err) == (0, "")
    summary = json.loads(out)
    assert summary["physics"] == "mujoco"
    (robot,) = summary["robots"]
    assert 0.5 < robot["path_true"] < 1.0
    assert robot["end_error"] < 0.01


def test_sim_of_a_bad_file_and_a_bad_twist(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("sim", "bad.yaml")
    assert (status, out) == (1, "")
    assert "bad.yaml:2:7" in err
    status, out, err = thorvaldc("sim", "good.yaml", "--twist", "fast")
    assert (status, out) == (2, "")
    assert "fast" in err


@pytest.mark.parametrize("preset", ["4wd4ws", "2wd0ws", "1wd1ws"])
def test_new_creates_a_robot_without_errors(thorvaldc: Command, preset: str) -> None:
    status, out, _ = thorvaldc("new", "mine", "--preset", preset)
    assert status == 0
    assert out.startswith("mine/robot.yaml")
    assert thorvaldc("check", "--strict", "mine/robot.yaml").status == 0
    modeline = Path("mine/robot.yaml").read_text(encoding="utf-8").partition("\n")[0]
    assert modeline == "# yaml-language-server: $schema=robot.schema.json"
    schema = Path("mine/robot.schema.json").read_text(encoding="utf-8")
    assert schema == thorvaldc("schema", "robot").out
    assert preset in thorvaldc("new", "--help").out
    again = thorvaldc("new", "mine", "--preset", preset)
    assert again.status == 2
    assert "already" in again.err


def test_new_writes_the_file_of_a_unit_beside_its_design(thorvaldc: Command) -> None:
    assert thorvaldc("new", "mine").status == 0
    status, out, _ = thorvaldc("new", "second", "--of", "mine/robot.yaml")
    assert (status, out.partition(":")[0]) == (0, "mine/second.yaml")
    assert thorvaldc("check", "--strict", "mine/second.yaml").status == 0
    modeline = Path("mine/second.yaml").read_text(encoding="utf-8").partition("\n")[0]
    assert modeline == "# yaml-language-server: $schema=robot.schema.json"
    difference = thorvaldc("diff", "mine/robot.yaml", "mine/second.yaml")
    assert "~ name          mine -> second" in difference.out
    for words, message in (
        (("second", "--of", "mine/robot.yaml"), "mine/second.yaml exists already"),
        (("third", "--of", "mine/robt.yaml"), "there is no file 'mine/robt.yaml'"),
        (("third", "--of", "mine/robot.yaml", "--project"), "a design has its own"),
        (("--of", "mine/robot.yaml"), "give the robot a name"),
    ):
        refused = thorvaldc("new", *words)
        assert refused.status == 2
        assert message in refused.err


def test_new_asks_a_terminal_until_the_answers_are_right(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["3wd", "2wd0ws", "my-robot", "", "4wd4ws"])
    monkeypatch.setattr("thorvaldc.cli.library_commands._is_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: next(answers))
    status, out, _ = thorvaldc("new")
    assert status == 0
    assert "  2wd0ws  Two driven wheels on one motor controller" in out
    assert "there is no preset '3wd'" in out
    assert "did you mean `my_robot`?" in out
    assert "my_robot/robot.yaml: a 2wd0ws robot" in out
    assert "base_calculator: differential" in Path("my_robot/robot.yaml").read_text()

    def interrupt(question: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("builtins.input", interrupt)
    before = sorted(Path().iterdir())
    assert thorvaldc("new").status == 130
    assert sorted(Path().iterdir()) == before


def test_targets(thorvaldc: Command) -> None:
    names = backends.names()
    assert {"urdf", "mjcf"} < {*names}
    assert [line.split()[0] for line in thorvaldc("targets").out.splitlines()] == names
    assert [*json.loads(thorvaldc("targets", "--json").out)] == names


@pytest.mark.parametrize(
    "kind",
    [
        "robot",
        "module",
        "fleet",
        "calibration",
        "scenario",
        "study",
        "bus_faults",
        "device_memory",
        "model",
    ],
)
def test_schema_is_a_complete_document(thorvaldc: Command, kind: str) -> None:
    import jsonschema

    schema = json.loads(thorvaldc("schema", kind).out)
    jsonschema.Draft202012Validator.check_schema(schema)
    references = re.findall(r'"\$ref": "([^"]*)"', json.dumps(schema))
    assert all(reference.startswith("#") for reference in references)


def test_explain_without_a_code_lists_all_codes(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("explain")
    assert status == 0
    assert out.startswith("YAML:\n  TV101  yaml-syntax ")
    assert all(f"  {code.number}  {code.name} " in out for code in CODES.values())


def test_reports_as_json(thorvaldc: Command) -> None:
    codes = json.loads(thorvaldc("explain", "--json").out)
    assert [code["number"] for code in codes] == [code.number for code in CODES.values()]
    assert json.loads(thorvaldc("explain", "TV501", "--json").out)["page"].startswith("# TV501")
    for command in (("check", "good.yaml"), ("build", "good.yaml"), ("modules", "check")):
        assert thorvaldc(*command, "--json") == thorvaldc(*command, "--format", "json")


def test_a_build_names_the_targets_that_it_removes(thorvaldc: Command) -> None:
    assert "removed" not in thorvaldc("build", "good.yaml", "-t", "urdf,mjcf").out
    assert "removed" not in thorvaldc("build", "good.yaml", "-t", "urdf,mjcf").out
    output = thorvaldc("build", "good.yaml", "-t", "urdf").out
    assert output.endswith(" (urdf); removed mjcf of the last build\n")


def test_warnings_take_one_line_where_the_robot_is_only_used(thorvaldc: Command) -> None:
    text = Path("good.yaml").read_text("utf-8")
    Path("fast.yaml").write_text(text + "driver: {max_linear_velocity: 50 m/s}\n", "utf-8")
    assert "warning[TV416]" in thorvaldc("check", "fast.yaml").out
    for command in (("info", "fast.yaml"), ("why", "fast.yaml", "mass")):
        error = thorvaldc(*command).err
        assert error == "fast.yaml: 1 warning; `thorvaldc check` shows them\n"


def test_explain_accepts_number_and_name(thorvaldc: Command) -> None:
    code = next(iter(CODES.values()))
    output = thorvaldc("explain", code.number)
    assert output.status == 0
    assert code.number in output.out
    assert thorvaldc("explain", code.name) == output
    assert thorvaldc("explain", code.number.lower()) == output


def test_modules_list_and_show(thorvaldc: Command) -> None:
    assert "drive/standard" in thorvaldc("modules", "list").out
    listed = json.loads(thorvaldc("modules", "list", "--json").out)
    assert "gear_ratio" in next(m for m in listed if m["type"] == "drive/standard")["params"]
    output = thorvaldc("modules", "show", "drive/standard").out
    assert "gear_ratio" in output
    assert "published: " in output
    assert "10 kg" in output
    assert (
        "gear_ratio"
        in json.loads(thorvaldc("modules", "show", "drive/standard", "--json").out)["params"]
    )


def test_modules_check(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("modules", "check")
    assert status == 0, out
    Path("lib/wheel/odd").mkdir(parents=True)
    Path("lib/wheel/odd/module.yaml").write_text("thorvaldc: 1\nlinkz: {}\n")
    status, out, _ = thorvaldc("modules", "check", "lib")
    assert status == 1
    assert "lib/wheel/odd/module.yaml:2:1" in out


def test_the_option_adds_a_library_folder(thorvaldc: Command) -> None:
    source = Path(__file__).parents[2] / "modules/wheel/agri_200"
    shutil.copytree(source, "lib/wheel/mine")
    assert "wheel/mine" in thorvaldc("modules", "list", "--library", "lib").out
    Path("robot.yaml").write_text(
        GOOD.replace("modules:\n", "defaults: {drive: {wheel: wheel/mine}}\nmodules:\n")
    )
    assert thorvaldc("check", "robot.yaml").status == 1
    assert thorvaldc("check", "robot.yaml", "--library", "lib").status == 0


def test_import_makes_the_folder_of_its_output(thorvaldc: Command) -> None:
    original = "motor_drives: {drive0: {node: 1, x: 0, y: 0}}\n"
    Path("original.yaml").write_text(original, encoding="utf-8")
    output = Path("new", "folder", "robot.yaml")
    assert thorvaldc("import", "original.yaml", "-o", str(output)).status == 0
    assert output.read_text(encoding="utf-8").startswith("# Converted from original.yaml")
    again = thorvaldc("import", "original.yaml", "-o", str(output))
    assert (again.status, "will not overwrite" in again.err) == (3, True)
    inside_a_file = thorvaldc("import", "original.yaml", "-o", "original.yaml/robot.yaml")
    assert inside_a_file.status == 3
    assert "original.yaml" in inside_a_file.err
