"""The wheel ``thorvaldc-runtime`` drives a robot without the compiler, numpy or MuJoCo."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.can.slcan_adapter import SlcanAdapter
from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD, SLOW, needs_tools
from tests.cli.test_bus import running
from tests.packaging import runtime_environment
from tests.terminal_operator import answer_questions
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

# One worker runs all these tests: then the wheel is built once.  It contains some tools.
pytestmark = [pytest.mark.xdist_group("packaging"), needs_tools]

ABSENT = ("numpy", "mujoco", "yaml", "jsonschema", "trimesh", "xacro", "jinja2", "cantools")
ROOMS_LEFT_OUT = ("compiler", "simulation", "schema")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return runtime_environment.build_wheel(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def runtime(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns the ``bin`` of an environment with the runtime wheel, and pyserial for slcan."""
    home = tmp_path_factory.mktemp("robot_computer")
    return runtime_environment.create(home, wheel, ("python-can", "typer", "pyserial"))


@pytest.fixture
def build(tmp_path: Path) -> Path:
    """Returns a folder with ``good.yaml`` and ``model.json``, the input of a robot's computer."""
    (tmp_path / "good.yaml").write_text(GOOD + SLOW)
    compilation = compile_file(tmp_path / "good.yaml")
    assert compilation.model is not None
    (tmp_path / "model.json").write_bytes(emit(compilation.model, ["can"])["model.json"])
    return tmp_path


def environment_of(folder: Path) -> dict[str, str]:
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return {**variables, "XDG_RUNTIME_DIR": str(folder), "XDG_STATE_HOME": str(folder / "state")}


def call(runtime: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(runtime / "thorvaldc"), *arguments],
        cwd=folder,
        env=environment_of(folder),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_wheel_contains_only_the_rooms_of_the_runtime(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for room in ("can", "cli", "commissioning", "diagnostics", "model", "ros", "runtime"):
        assert f"thorvaldc/{room}/__init__.py" in names
    for room in ROOMS_LEFT_OUT:
        assert not [name for name in names if name.startswith(f"thorvaldc/{room}/")]
    backends = [Path(name).name for name in names if name.startswith("thorvaldc/backends/")]
    assert sorted(backends) == ["__init__.py", "computer.py"]


@pytest.mark.slow
def test_the_environment_has_no_compiler_and_no_numpy(runtime: Path, tmp_path: Path) -> None:
    program = (
        "import importlib.util as u\n"
        f"print([n for n in {ABSENT!r} if u.find_spec(n)]"
        f" + [n for n in {ROOMS_LEFT_OUT!r} if u.find_spec('thorvaldc.' + n)])"
    )
    process = subprocess.run(
        [str(runtime / "python"), "-c", program],
        cwd=tmp_path,
        env=environment_of(tmp_path),
        capture_output=True,
        text=True,
        check=True,
    )
    assert process.stdout == "[]\n"


@pytest.mark.slow
def test_the_api_has_the_names_of_the_runtime(runtime: Path, tmp_path: Path) -> None:
    program = (
        "import pydoc, thorvaldc\n"
        "assert 'BaseDriver' in dir(thorvaldc) and 'load' not in dir(thorvaldc)\n"
        "assert 'class BaseDriver' in pydoc.plain(pydoc.render_doc(thorvaldc))\n"
        "try:\n    thorvaldc.load\nexcept AttributeError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [str(runtime / "python"), "-c", program],
        cwd=tmp_path,
        env=environment_of(tmp_path),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout == (
        "thorvaldc.load is not in this installation, which is the runtime alone; install the wheel"
        " or the checkout of the whole package\n"
    )


@pytest.mark.slow
def test_every_module_of_the_runtime_can_be_imported(runtime: Path, tmp_path: Path) -> None:
    program = (
        "import importlib, pkgutil, thorvaldc\n"
        "for room in ('can', 'commissioning', 'diagnostics', 'model', 'runtime'):\n"
        "    package = importlib.import_module('thorvaldc.' + room)\n"
        "    for info in pkgutil.walk_packages(package.__path__, package.__name__ + '.'):\n"
        "        importlib.import_module(info.name)\n"
    )
    subprocess.run(
        [str(runtime / "python"), "-W", "error", "-c", program],
        cwd=tmp_path,
        env=environment_of(tmp_path),
        check=True,
    )


@pytest.mark.slow
def test_run_drives_a_simulated_robot_of_another_process(runtime: Path, build: Path) -> None:
    with running(build, "good.yaml") as (_, bus):
        drive = call(
            runtime,
            build,
            *("run", "model.json", "--bus", f"sim:{bus['channel']}"),
            *("--twist", "0.4,0,0", "--duration", "2 s", "--json"),
        )
    assert drive.returncode == 0, drive.stderr
    summary = json.loads(drive.stdout)
    assert summary["was_ready"]
    assert summary["pose"]["x"] > 0.3


@pytest.mark.slow
def test_run_drives_over_python_can(runtime: Path, build: Path) -> None:
    robot = compile_file(build / "good.yaml").model
    assert isinstance(robot, Robot)
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    adapter = SlcanAdapter(simulated)
    process = ChildProcess(
        [
            *(str(runtime / "thorvaldc"), "run", "model.json", "--bus", f"slcan:{adapter.path}"),
            *("--twist", "0.4,0,0", "--duration", "2 s", "--json"),
        ],
        cwd=build,
        env=environment_of(build),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    adapter.serve(lambda: process.poll() is not None, 60.0)
    out, err = process.communicate(timeout=300)
    adapter.close()
    assert process.returncode == 0, err
    assert json.loads(out)["pose"]["x"] > 0.2


@pytest.mark.slow
def test_scan_verify_and_identify(runtime: Path, build: Path) -> None:
    with running(build, "good.yaml") as (_, bus):
        channel = f"sim:{bus['channel']}"
        scan = call(runtime, build, "can", "scan", "model.json", "--bus", channel, "--json")
        verify = call(runtime, build, "can", "verify", "model.json", "--bus", channel)
        identify = call(runtime, build, "can", "identify", ".", "--bus", channel)
        refused = call(runtime, build, "can", "identify", "good.yaml", "--bus", channel)
    assert scan.returncode == 0, scan.stderr
    assert json.loads(scan.stdout)
    assert verify.returncode == 0, verify.stderr
    assert identify.returncode == 0, identify.stderr
    assert "model.json" in identify.stdout
    assert refused.returncode == 3, refused.stderr
    assert "good.yaml needs the compiler" in refused.stderr


@pytest.mark.slow
def test_commission_drives_one_motor_at_a_terminal(runtime: Path, build: Path) -> None:
    with running(build, "good.yaml") as (_, bus):
        channel = f"sim:{bus['channel']}"
        refused = call(runtime, build, "can", "commission", "model.json", "--bus", channel)
        status, shown = answer_questions(
            [str(runtime / "thorvaldc"), "can", "commission", "model.json", "--bus", channel],
            {
                "turns forwards once": "",
                "Which wheel moved?": "1",
                "How many turns": "1",
                "by the safety stop": "",
                "as if this program": "",
                "come to rest by itself?": "\x03",  # test_motor_checks.py has the other checks
            },
            build,
            environment_of(build),
        )
    assert refused.returncode == 2, refused.stderr
    assert status == 1, shown
    report = json.loads((build / "good.commission.json").read_text(encoding="utf-8"))
    assert report["interruption"] == "ended by the operator"
    assert {motor["state"] for motor in report["motors"]} == {"not tested"}
    assert max(map(len, shown.splitlines())) <= 80
    for text in (">>[1]<<", "Look now", "wheel fl_wheel"):
        assert text in shown


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "status"),
    [("check", 3), ("build", 3), ("sim", 3), ("view", 2), ("render", 2), ("import", 2)],
)
def test_commands_of_the_compiler_name_the_package_to_install(
    runtime: Path, build: Path, command: str, status: int
) -> None:
    """The names of tools that the runtime does not have are not known there."""
    refused = call(runtime, build, command, "good.yaml")
    assert refused.returncode == status, refused.stderr
    assert "pip uninstall thorvaldc-runtime" in refused.stderr
    assert "Traceback" not in refused.stderr


@pytest.mark.slow
def test_run_with_a_robot_file_needs_the_compiler(runtime: Path, build: Path) -> None:
    refused = call(runtime, build, "run", "good.yaml", "--bus", "sim:nobody")
    assert refused.returncode == 3, refused.stderr
    assert "model.json" in refused.stderr


@pytest.mark.slow
def test_help_names_the_commands(runtime: Path, tmp_path: Path) -> None:
    shown = call(runtime, tmp_path, "--help")
    assert shown.returncode == 0
    assert " run " in shown.stdout
    assert shown.stderr == ""


@pytest.mark.slow
def test_runtime_has_its_own_interpreter(runtime: Path) -> None:
    """Another interpreter would find the packages of the environment that runs the tests."""
    assert (runtime / "python").exists()
    assert str(runtime) not in sys.path
