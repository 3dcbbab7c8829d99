"""Each extra in an environment that has only it: the whole output of its commands.

A package that only another extra installs may change what a command prints, or end it.
"""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import time
import tomllib
import tty
import urllib.request
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import GOOD, needs_tools
from tests.outside_tools import path_of_usd_python, without
from tests.packaging.runtime_environment import create_linked

ROOT = Path(__file__).resolve().parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
FOR_DEVELOPERS = {"dev", "bench", "docs"}
# `test_warp_env.py` compares the output in an environment with only that, where kernels take a
# minute to compile.
SHOWN_ELSEWHERE = {"all", "warp"}

pytestmark = needs_tools
slow = pytest.mark.slow


class Result(NamedTuple):
    status: int
    out: str
    err: str


class Computer:
    """A folder with ``good.yaml``, and a Python that has one extra and the plain package."""

    def __init__(self, extra: str, folder: Path) -> None:
        self.folder = folder
        self.variables = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        if extra == "usd":  # it needs another version of MuJoCo
            self.python = path_of_usd_python(converter=True)
            self.variables["PYTHONPATH"] = str(ROOT)
        else:
            lines = [*PROJECT["dependencies"], *EXTRAS[extra]]
            self.python = str(create_linked(folder / "environment", lines))
        (folder / "good.yaml").write_text(GOOD, encoding="utf-8")

    def start(self, *words: str, **options: Any) -> ChildProcess:
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        return ChildProcess(
            [self.python, "-W", "default", *words],
            **{"cwd": self.folder, "env": self.variables, "text": True, **streams, **options},
        )

    def run(self, *words: str, text: str = "") -> Result:
        process = self.start(*words)
        out, err = process.communicate(text, timeout=300)
        if "neither EGL nor OSMesa works" in err:
            without(err)
        return Result(process.returncode, re.sub(r" +\d+x\n", "  FAST\n", out), err)

    def thorvaldc(self, *arguments: str) -> Result:
        return self.run("-m", "thorvaldc", *arguments)


@pytest.fixture
def computer(request: pytest.FixtureRequest, tmp_path: Path) -> Computer:
    """Named ``test_<extra>_...``."""
    return Computer(request.node.originalname.split("_")[1], tmp_path)


TABLE = """\
robot      mass  wheels driven/steered  commanded     true  odometry  end error  real time
good   141.1 kg                 4: 4/4    0.002 m  0.001 m   0.001 m     0.0 mm{}
"""
DRIVE = ("sim", "good.yaml", "--duration", "0.1")
DROVE = TABLE.format("  FAST")


def test_every_extra_for_users_has_a_test() -> None:
    names = {name.split("_")[1] for name in globals() if name.endswith("_alone")}
    assert names == EXTRAS.keys() - FOR_DEVELOPERS - SHOWN_ELSEWHERE


def test_record_alone(computer: Computer) -> None:
    written = computer.thorvaldc(*DRIVE, "--record", "o.mcap")
    assert written == (0, DROVE, "o.mcap, o.foxglove.json\n")


@slow
def test_plot_alone(computer: Computer) -> None:
    result = computer.thorvaldc(*DRIVE, "--plot", "o.png")
    assert result == (0, DROVE, "o.png\n")


@slow
def test_video_alone(computer: Computer) -> None:
    for file in ("o.gif", "o.mp4"):
        result = computer.thorvaldc(*DRIVE, "--video", file)
        assert result == (0, DROVE, f"{file}\n")


DBC = 'BO_ 1 State: 1 A\n SG_ on : 0|1@1+ (1,0) [0|0] "" B\n'


@slow
def test_dbc_alone(computer: Computer) -> None:
    (computer.folder / "mine.dbc").write_text(DBC, encoding="utf-8")
    result = computer.thorvaldc("modules", "from-dbc", "io/mine", "mine.dbc", "--node", "A")
    assert (result.status, result.err) == (0, "")
    assert "1 frame." in result.out


EVDEV = """\
class ecodes:
    ecodes = {}

def InputDevice(path):
    raise FileNotFoundError(path)
"""


@slow
def test_joystick_alone(computer: Computer) -> None:
    # To install evdev, a C compiler and the headers of Linux are needed.
    if "evdev" not in packages_distributions():
        (computer.folder / "evdev.py").write_text(EVDEV, encoding="utf-8")
    result = computer.thorvaldc("teleop", "good.yaml", "--on", "ideal", "--joystick", "event999")
    assert result == (
        3,
        "",
        "error: there is no joystick at event999; is it plugged in, and has your user permission to"
        " read it (group `input`)?\n",
    )


SILENCE = "no frame received; the node may be there without sending"
SCAN = f"""\
verdict  node           id  found  device
missing  fl_controller  1          {SILENCE}
missing  fr_controller  2          {SILENCE}
missing  rl_controller  3          {SILENCE}
missing  rr_controller  4          {SILENCE}
missing  battery        1          {SILENCE}
"""
LISTENED = "the scan only listened; --active sends a request to every node\n"
HARDWARE = (
    "note: this was never tried on physical hardware, only on simulated buses. Lift the wheels off"
    " the ground and keep the emergency stop in reach.\n"
)


@slow
def test_serial_alone(computer: Computer) -> None:
    ends = pty.openpty()
    for end in ends:
        tty.setraw(end)
    result = computer.thorvaldc("can", "scan", "good.yaml", "--bus", f"slcan:{os.ttyname(ends[1])}")
    for end in ends:
        os.close(end)
    assert result == (1, SCAN, HARDWARE + LISTENED)


@slow
def test_udp_alone(computer: Computer) -> None:
    result = computer.thorvaldc("can", "scan", "good.yaml", "--bus", "udp:239.74.163.81")
    assert result == (1, SCAN, LISTENED)


@slow
def test_lsp_alone(computer: Computer) -> None:
    messages: list[dict[str, Any]] = [
        {"id": 1, "method": "initialize", "params": {"capabilities": {}}},
        {"method": "initialized", "params": {}},
        {"id": 2, "method": "shutdown"},
        {"method": "exit"},
    ]
    texts = [json.dumps({"jsonrpc": "2.0", **message}) for message in messages]
    framed = "".join(f"Content-Length: {len(text)}\r\n\r\n{text}" for text in texts)
    status, out, err = computer.run("-m", "thorvaldc", "lsp", text=framed)
    answers = [json.loads(text) for text in re.findall(r"^{.*?}(?=Content|\Z)", out, re.M | re.S)]
    assert [answer["id"] for answer in answers] == [1, 2]
    assert answers[0]["result"]["serverInfo"]["name"] == "thorvaldc"
    assert (status, err) == (0, "")


@slow
def test_preview_alone(computer: Computer) -> None:
    process = computer.start("-m", "thorvaldc", "preview", "good.yaml", "--no-browser")
    with urllib.request.urlopen(process.stdout.readline().strip(), timeout=60) as page:
        assert "<title>" in page.read().decode()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (out, err) == ("", "")


STUDY = """\
thorvaldc: 1
study: track
robot: good.yaml
variables:
  track: {paths: [modules.frame.params.width], min: 0.9 m, max: 1 m}
objectives:
  light: {fact: mass, goal: minimise}
samples: {method: sobol, number: 2}
"""
DESIGNS = """\
track: 2 designs: 2 ok
sample  track   light (minimise)
1       0.941   141.3
2       0.9754  141.4
SI units, angles in rad
"""


@slow
def test_study_alone(computer: Computer) -> None:
    (computer.folder / "study.yaml").write_text(STUDY, encoding="utf-8")
    run = computer.thorvaldc("study", "run", "study.yaml", "-j", "1")
    assert run == (0, DESIGNS, "wrote study/track/designs.parquet\n")
    plots = computer.thorvaldc("study", "show", "study.yaml", "--html", "plots.html")
    assert plots == (0, DESIGNS, "wrote plots.html\n")
    two = computer.thorvaldc("study", "run", "study.yaml", "-j", "2", "-o", "two")
    assert two == (0, DESIGNS, "wrote two/designs.parquet\n")
    # The scheduler and the worker are commands of Dask, which log what they do.
    quiet = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    file = computer.folder / "scheduler.json"
    where = ("--scheduler-file", str(file), "--no-dashboard")
    computer.start("-m", "dask", "scheduler", "--host", "127.0.0.1", "--port", "0", *where, **quiet)
    computer.start("-m", "dask", "worker", "--no-nanny", "--nthreads", "1", *where, **quiet)
    while not (file.exists() and file.read_text().endswith("}")):
        time.sleep(0.05)
    address = json.loads(file.read_text())["address"]
    run = computer.thorvaldc("study", "run", "study.yaml", "--scheduler", address, "-o", "dask")
    assert run == (0, DESIGNS, "wrote dask/designs.parquet\n")


ENVIRONMENT = "thorvaldc.tools.gym.environments:thorvaldc/Robot-v0"


@slow
def test_gym_alone(computer: Computer) -> None:
    result = computer.run(
        "-c",
        "import gymnasium\n"
        f"env = gymnasium.make({ENVIRONMENT!r}, file='good.yaml')\n"
        "print(env.reset(seed=1)[0].shape, env.step(env.action_space.sample())[0].shape)\n"
        "env.close()\n",
    )
    assert result == (0, "(14,) (14,)\n", "")


@slow
def test_batch_alone(computer: Computer) -> None:
    result = computer.run(
        "-c",
        "import gymnasium\n"
        f"envs = gymnasium.make_vec({ENVIRONMENT!r}, 2, file='good.yaml')\n"
        "print(envs.reset(seed=1)[0].shape, envs.step(envs.action_space.sample())[0].shape)\n"
        "envs.close()\n",
    )
    assert result == (0, "(2, 14) (2, 14)\n", "")


@slow
def test_usd_alone(computer: Computer) -> None:
    result = computer.thorvaldc("usd", "good.yaml", "-o", "o.usda")
    assert result == (0, "o.usda\n", "")
