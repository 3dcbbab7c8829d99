"""`thorvaldc can commission` and the report that `run --commissioned` demands."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Command, run_in_this_process
from tests.slow import mostly_slow, one_quick_of
from thorvaldc.commissioning import commission_page
from thorvaldc.commissioning.commission_report import CommissionReport, driven_joints, motor_key
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Robot
from thorvaldc.model.model_json import from_json, to_json
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.runtime.run_session import RunSession
from thorvaldc.simulation.bus import simulated_robot
from thorvaldc.simulation.bus.motor_wiring import Wiring
from thorvaldc.tools.commission.console_operator import ConsoleOperator
from thorvaldc.tools.commission.questions import Question, plan_view

GREENHOUSE = """
thorvaldc: 1
name: house
base_calculator: differential
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, cross_members: [0]}}
  left: {type: assembly/fixed_drive, mount: frame.front_left}
  right: {type: assembly/fixed_drive, mount: frame.front_right}
  controller: {type: controller/propulsion_propulsion, can: 1, channels:
    {left: left.propulsion, right: right.propulsion}}
  caster_left: {type: caster/swivel, mount: frame.rear_left}
  caster_right: {type: caster/swivel, mount: frame.rear_right}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text(GREENHOUSE, encoding="utf-8")
    return tmp_path


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of a right robot, as JSON."""
    path = tmp_path_factory.mktemp("commissioned")
    (path / "robot.yaml").write_text(GREENHOUSE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as monkeypatch:
        run = run_in_this_process(monkeypatch, path)
        assert run("can", "commission", "robot.yaml", "--bus", "virtual").status == 0
    return (path / "robot.commission.json").read_text(encoding="utf-8")


def wire(monkeypatch: pytest.MonkeyPatch, **wiring: Wiring) -> None:
    """Lets `--bus virtual` simulate a robot that is wired like this."""
    constructor = simulated_robot.SimulatedRobot.__init__

    def wired(self: simulated_robot.SimulatedRobot, robot: Robot, **options: object) -> None:
        constructor(self, robot, **{**options, "wiring": wiring})  # type: ignore[arg-type]

    monkeypatch.setattr(simulated_robot.SimulatedRobot, "__init__", wired)


def test_a_run_demands_a_report_of_the_same_model(thorvaldc: Command, folder: Path) -> None:
    file = str(folder / "robot.yaml")
    run = ("run", file, "--bus", "virtual", "--fast", "--duration", "1s", "--commissioned")
    refused = thorvaldc(*run)
    assert refused.status == 1
    assert "TV881" in refused.err
    assert "robot.commission.json: No such file" in refused.err

    checked = thorvaldc("can", "commission", file, "--bus", "virtual", "--operator", "Kari")
    assert checked.status == 0
    assert "house: passed" in checked.out
    assert "Lift all wheels off the ground" in checked.err
    assert thorvaldc(*run).status == 0

    report = json.loads((folder / "robot.commission.json").read_text(encoding="utf-8"))
    assert report["operator"] == "Kari"
    assert report["passed"] is True
    assert "no serial number is known of controller" in checked.err
    assert [node["serial"] for node in report["nodes"]] == [None]
    for motor in report["motors"]:
        assert motor["state"] == "passed"
        assert all(f["least"] <= f["value"] <= f["most"] for f in motor["figures"])

    # A comment changes no hash; another encoder does.
    text = Path(file).read_text(encoding="utf-8")
    Path(file).write_text(f"# moved to the shed\n{text}", encoding="utf-8")
    assert thorvaldc(*run).status == 0
    changed = text.replace("front_left}", "front_left, params: {encoder_ppr: 2048}}")
    Path(file).write_text(changed, encoding="utf-8")
    other = thorvaldc(*run)
    assert other.status == 1
    assert "left_drive_propulsion has changed since" in other.err
    assert "right_drive_propulsion" not in other.err


def test_motors_that_have_passed_are_not_repeated(
    thorvaldc: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = str(folder / "robot.yaml")
    command = ("can", "commission", file, "--bus", "virtual")
    with monkeypatch.context() as patch:
        wire(patch, left_drive_propulsion=Wiring(direction=-1))
        failed = thorvaldc(*command, "--json")
    assert failed.status == 1
    report = json.loads(failed.out)
    assert [motor["state"] for motor in report["motors"]] == ["failed", "passed"]
    assert report["findings"][0]["motors"] == ["left_drive_propulsion"]
    assert "inverted: true" in report["findings"][0]["change"]
    run = thorvaldc("run", file, "--bus", "virtual", "--fast", "--duration=1s", "--commissioned")
    assert "left_drive_propulsion is failed" in run.err

    # What the finding proposes makes the file right.
    text = Path(file).read_text(encoding="utf-8")
    changed = text.replace("front_left}", "front_left, params: {inverted: true}}")
    Path(file).write_text(changed, encoding="utf-8")
    repaired = thorvaldc(*command)
    assert repaired.status == 0
    assert "not repeated: right_drive_propulsion" in repaired.err
    again = thorvaldc(*command, "--again")
    assert again.status == 0
    assert "not repeated" not in again.err


def test_the_page_shows_what_to_change(
    thorvaldc: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire(monkeypatch, left_drive_propulsion=Wiring(encoder_scale=-1.0))
    report = folder / "first.json"
    command = ("can", "commission", str(folder / "robot.yaml"), "--bus", "virtual")
    result = thorvaldc(*command, "--report", str(report))
    assert result.status == 1
    assert "counts against its motor" in result.out
    page = report.with_suffix(".html").read_text(encoding="utf-8")
    assert "exchange the lines A and B" in page
    assert "not passed" in page
    assert page.count("<rect") == 4
    assert page.count("fill='#b00020'") == 1


def test_usage(thorvaldc: Command, folder: Path) -> None:
    file = str(folder / "robot.yaml")
    terminal = thorvaldc("can", "commission", file, "--bus", "socketcan:can0")
    assert terminal.status == 2
    assert "needs a terminal to ask at" in terminal.err
    suffix = thorvaldc("can", "commission", file, "--bus", "virtual", "--report", "a.txt")
    assert suffix.status == 2
    (folder / "bad.json").write_text("[]", encoding="utf-8")
    command = ("can", "commission", file, "--bus", "virtual", "--report")
    bad = thorvaldc(*command, str(folder / "bad.json"))
    assert bad.status == 1
    assert "is no report of `can commission`" in bad.err
    assert (folder / "bad.json").read_text(encoding="utf-8") == "[]"
    missing = thorvaldc(*command, str(folder / "no" / "folder.json"))
    assert missing.status == 3
    assert "cannot write" in missing.err


def test_a_motor_is_the_same_in_the_build(folder: Path) -> None:
    robot = compile_file(folder / "robot.yaml").model
    assert isinstance(robot, Robot)
    built = from_json(to_json(robot))
    assert isinstance(built, Robot)
    for motor, of_build in zip(driven_joints(robot), driven_joints(built), strict=True):
        assert motor_key(robot, motor) == motor_key(built, of_build)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"motors": 7}, "report.motors: expected a list"),
        ({"motors": [{"name": "left_drive_propulsion", "state": "passed"}]}, "is missing"),
        ({"findings": [{"motors": ["a"], "text": 1, "change": ""}]}, "expected text"),
        ({"version": 99}, "has the version 99"),
        ({"date": None}, "report.date: expected text"),
        ({"extra": 1}, "there is no field `extra`"),
    ],
)
def test_a_damaged_report_is_an_error(
    thorvaldc: Command, folder: Path, report: str, change: dict[str, object], text: str
) -> None:
    command = ("can", "commission", str(folder / "robot.yaml"), "--bus", "virtual")
    path = folder / "robot.commission.json"
    path.write_text(json.dumps(json.loads(report) | change), encoding="utf-8")
    damaged = thorvaldc(*command)
    assert damaged.status == 1
    assert "TV881" in damaged.err
    assert text in damaged.err


Edit = Callable[[dict[str, Any]], object]


def of_motor(**fields: object) -> Edit:
    return lambda report: report["motors"][0].update(fields)


def of_figure(**fields: object) -> Edit:
    return lambda report: report["motors"][0]["figures"][0].update(fields)


def of_device(**fields: object) -> Edit:
    return lambda report: report["nodes"][0].update(fields)


def finding(*motors: str) -> list[dict[str, object]]:
    return [{"motors": motors, "text": "a", "change": "b"}]


LEFT, RIGHT = "left_drive_propulsion", "right_drive_propulsion"
EDITS: dict[str, tuple[Edit, str]] = {
    "not passed": (lambda report: report.update(passed=False), "`passed` does not fit"),
    "interrupted": (
        lambda report: report.update(interruption="power cut", passed=False),
        "the checks were interrupted: power cut",
    ),
    "interrupted, edited": (lambda report: report.update(interruption="power cut"), "does not fit"),
    "finding": (lambda report: report.update(passed=False, findings=finding()), "it has findings"),
    "finding, edited": (lambda report: report.update(findings=finding()), "does not fit"),
    "finding of a motor": (
        lambda report: report.update(passed=False, findings=finding(LEFT)),
        f"{LEFT} has a finding",
    ),
    "failed": (of_motor(state="failed"), "does not fit"),
    "left out": (
        lambda report: (report.update(passed=False), of_motor(state="left out")(report)),
        f"{LEFT} is left out",
    ),
    "no figures": (of_motor(figures=[]), f"{LEFT} has a figure that is missing"),
    "figure out of bounds": (of_figure(value=9e9), "has a figure that is missing or out of"),
    "figure not reached": (of_figure(value=None), "has a figure that is missing or out of"),
    "figure is no number": (of_figure(value=math.nan), "expected a finite number"),
    "unbounded figure": (of_figure(most=math.inf), "expected a finite number"),
    "another robot": (lambda report: report.update(robot="barn"), "was checked at the robot barn"),
    "a motor twice": (
        lambda report: report["motors"].append(report["motors"][0]),
        f"{LEFT} is in the report more than once",
    ),
    "no motor": (lambda report: report["motors"].pop(), f"{RIGHT} is not tested"),
    "no motors": (lambda report: report.update(motors=[]), f"{LEFT} is not tested"),
    "nothing moved": (of_motor(moved=None), f"{LEFT} moved nothing"),
    "another joint moved": (of_motor(moved=RIGHT), f"{LEFT} moved {RIGHT}"),
    "another key": (of_motor(key="0" * 16), f"{LEFT} has changed since"),
    "no controller": (
        lambda report: report.update(nodes=[]),
        "controller: the report does not say which device was checked",
    ),
    "a controller twice": (
        lambda report: report["nodes"].append(report["nodes"][0]),
        "controller: the report does not say which device was checked",
    ),
    "a missing controller": (of_device(state="missing"), "does not say which device"),
    "another serial number": (
        of_device(serial=0x999),
        "serial 0x999; now it is vendor",
    ),
    "another product": (of_device(product=0x777), "not the device that was checked"),
}


def same(report: dict[str, Any]) -> None:
    """Changes nothing."""


@pytest.mark.parametrize(("edit", "reason"), [(same, ""), *EDITS.values()], ids=["no edit", *EDITS])
def test_a_report_that_does_not_count_is_refused(
    thorvaldc: Command, folder: Path, report: str, edit: Edit, reason: str
) -> None:
    content = json.loads(report)
    edit(content)
    (folder / "robot.commission.json").write_text(json.dumps(content), encoding="utf-8")
    command = ("run", "robot.yaml", "--bus", "virtual", "--fast", "--duration", "0.1s")
    result = thorvaldc(*command, "--commissioned")
    words = " ".join(result.err.split())
    if edit is same:
        assert result.status == 0, words
        assert "note: no serial number is known of controller" in words
        return
    assert result.status == 1
    assert "TV881" in words
    assert reason in words
    assert not result.out  # no run began


@pytest.mark.parametrize(
    ("old", "new"),
    one_quick_of(
        3,
        [
            ("width: 0.9 m", "width: 1.1 m"),
            ("frame.front_left}\n  right", "frame.front_right}\n  right"),
            ("front_left}", "front_left, params: {inverted: true}}"),
        ],
    ),
)
def test_a_wheel_at_another_place_has_not_been_checked(
    thorvaldc: Command, folder: Path, report: str, old: str, new: str
) -> None:
    """Another track, exchanged mounts, another direction."""
    text = (folder / "robot.yaml").read_text(encoding="utf-8")
    assert old in text
    changed = text.replace(old, new)
    if "frame.front_right}\n  right" in changed:
        right = "right: {type: assembly/fixed_drive, mount: frame.front_"
        changed = changed.replace(f"{right}right", f"{right}left")
    (folder / "robot.yaml").write_text(changed, encoding="utf-8")
    (folder / "robot.commission.json").write_text(report, encoding="utf-8")
    run = ("run", "robot.yaml", "--bus", "virtual", "--fast", "--duration", "0.1s")
    refused = thorvaldc(*run, "--commissioned")
    assert refused.status == 1
    assert "left_drive_propulsion has changed since" in refused.err
    again = thorvaldc("can", "commission", "robot.yaml", "--bus", "virtual")
    kept = [line for line in again.err.splitlines() if "not repeated" in line]
    assert "left_drive_propulsion" not in "".join(kept)


# -- which devices were checked --------------------------------------------------------------------

ROVER = """
thorvaldc: 1
name: rover
base_calculator: differential
defaults: {drive: {controller: controller/cia402_propulsion}}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, cross_members: [0]}}
  left: {type: assembly/fixed_drive, mount: frame.front_left, can: 1}
  right: {type: assembly/fixed_drive, mount: frame.front_right, can: 2}
  caster_left: {type: caster/swivel, mount: frame.rear_left}
  caster_right: {type: caster/swivel, mount: frame.rear_right}
"""


def connect(monkeypatch: pytest.MonkeyPatch, **serials: str) -> None:
    """Lets `--bus virtual` simulate drives with these serial numbers."""
    constructor = simulated_robot.SimulatedRobot.__init__

    def labelled(self: simulated_robot.SimulatedRobot, robot: Robot, **options: object) -> None:
        (bus,) = robot.buses
        nodes = [replace(n, serial=serials.get(n.name, n.serial)) for n in bus.nodes]
        devices = replace(robot, buses=(replace(bus, nodes=tuple(nodes)),))
        constructor(self, devices, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(simulated_robot.SimulatedRobot, "__init__", labelled)


@pytest.mark.parametrize("stated", mostly_slow([False, True]), ids=["unknown", "in the robot file"])
def test_a_replaced_controller_has_not_been_checked(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stated: bool
) -> None:
    text = ROVER
    if stated:
        text = text.replace("can: 1", 'can: {id: 1, serial: "0x101"}')
    (tmp_path / "robot.yaml").write_text(text, encoding="utf-8")
    commission = ("can", "commission", "robot.yaml", "--bus", "virtual")
    run = ("run", "robot.yaml", "--bus", "virtual", "--fast", "--duration", "0.1s")
    with monkeypatch.context() as patch:
        connect(patch, left_controller="0x101", right_controller="0x102")
        first = thorvaldc(*commission)
        assert first.status == 0, first.err
        assert "no serial number" not in first.err
        allowed = thorvaldc(*run, "--commissioned")
        assert allowed.status == 0, allowed.err
    before = (tmp_path / "robot.commission.json").read_text(encoding="utf-8")
    with monkeypatch.context() as patch:
        connect(patch, left_controller="0x999", right_controller="0x102")
        refused = thorvaldc(*run, "--commissioned")
        again = thorvaldc(*commission)
    words = " ".join(refused.err.split())
    assert refused.status == 1
    assert not refused.out
    for part in ("left_controller is", "serial 0x101", "serial 0x999", "thorvaldc can commission"):
        assert part in words
    assert "right_controller" not in words
    after = (tmp_path / "robot.commission.json").read_text(encoding="utf-8")
    if stated:  # the file itself says that this is the wrong device
        assert again.status == 1
        assert "nothing was moved, and no report was written" in again.err
        assert after == before
        return
    # Only the motor of the new controller is checked again.
    assert again.status == 0
    assert "passed before, not repeated: right_drive_propulsion (" in again.err
    serials = {node["name"]: node["serial"] for node in json.loads(after)["nodes"]}
    assert serials["left_controller"] == 0x999
    with monkeypatch.context() as patch:
        connect(patch, left_controller="0x999", right_controller="0x102")
        assert thorvaldc(*run, "--commissioned").status == 0


def test_the_report_of_another_robot_of_the_same_kind_is_refused(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot.yaml").write_text(ROVER, encoding="utf-8")
    with monkeypatch.context() as patch:
        connect(patch, left_controller="0x101", right_controller="0x102")
        assert thorvaldc("can", "commission", "robot.yaml", "--bus", "virtual").status == 0
    connect(monkeypatch, left_controller="0x201", right_controller="0x202")
    run = ("run", "robot.yaml", "--bus", "virtual", "--fast", "--duration", "0.1s")
    refused = thorvaldc(*run, "--commissioned")
    words = " ".join(refused.err.split())
    assert refused.status == 1
    for part in ("left_controller is", "0x101", "0x201", "right_controller is", "0x102", "0x202"):
        assert part in words
    assert "thorvaldc can identify FOLDER" in words


def test_a_controller_that_does_not_answer_is_refused(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot.yaml").write_text(ROVER, encoding="utf-8")
    assert thorvaldc("can", "commission", "robot.yaml", "--bus", "virtual").status == 0
    power_on = simulated_robot.SimulatedRobot.power_on

    def without_left(self: simulated_robot.SimulatedRobot) -> None:
        power_on(self)
        self.devices["left_controller"].power_off()

    monkeypatch.setattr(simulated_robot.SimulatedRobot, "power_on", without_left)
    run = ("run", "robot.yaml", "--bus", "virtual", "--fast", "--duration", "0.1s")
    refused = thorvaldc(*run, "--commissioned")
    assert refused.status == 1
    assert "left_controller is missing: no device answers for it" in " ".join(refused.err.split())


def test_a_controller_that_is_replaced_during_a_run_is_refused(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reset after the replacement begins a new start, which compares the serial numbers."""
    (tmp_path / "robot.yaml").write_text(ROVER, encoding="utf-8")
    assert thorvaldc("can", "commission", "robot.yaml", "--bus", "virtual").status == 0
    simulations: list[simulated_robot.SimulatedRobot] = []
    power_on, run_to_end = simulated_robot.SimulatedRobot.power_on, RunSession.run
    replaced: list[float] = []

    def remember(self: simulated_robot.SimulatedRobot) -> None:
        simulations.append(self)
        power_on(self)

    def run_with_replacement(self: RunSession, watch: object) -> Diagnostic | None:
        self.duration = math.inf  # a person resets a fault: it does not end the run
        devices = simulations[-1].devices

        def replace_drive(driven: DrivenRobot, state: DriverState) -> None:
            fault = self.base.state is BaseState.FAULT
            if not replaced and self.base.state is BaseState.READY:
                replaced.append(driven.now)
                devices["left_controller"].power_off()
                simulations[-1].clone("left_controller", "spare").power_on()
            elif fault and self.base.state_machine.mismatch:
                self.stop_requested = True
            elif fault and driven.now - replaced[0] > 2.0:
                driven.reset()
            assert len(replaced) == 0 or driven.now - replaced[0] < 20.0

        return run_to_end(self, replace_drive)

    monkeypatch.setattr(simulated_robot.SimulatedRobot, "power_on", remember)
    monkeypatch.setattr(RunSession, "run", run_with_replacement)
    run = ("run", "robot.yaml", "--bus", "virtual", "--fast", "--duration", "30s")
    result = thorvaldc(*run, "--commissioned")
    assert result.status == 1
    assert replaced
    assert "left_controller: serial_number (0x1018:4) is" in " ".join(result.err.split())


def test_a_page_contains_no_markup_of_a_report(
    thorvaldc: Command, folder: Path, report: str
) -> None:
    path = folder / "robot.commission.json"
    command = ("can", "commission", str(folder / "robot.yaml"), "--bus", "virtual")
    content = json.loads(report)
    content["motors"][0]["figures"][0] |= {"name": "<img>", "unit": "<b>"}
    path.write_text(json.dumps(content), encoding="utf-8")
    assert thorvaldc(*command, "--operator", "<script>").status == 0
    page = path.with_suffix(".html").read_text(encoding="utf-8")
    assert not any(tag in page for tag in ("<script", "<img", "<b>"))
    assert "&lt;img&gt;" in page


# -- the terminal ----------------------------------------------------------------------------------


class Lines:
    """Standard input of which a test gives the lines."""

    def __init__(self, *lines: str) -> None:
        self._lines = lines

    def __iter__(self) -> object:
        return iter(self._lines)


@pytest.mark.parametrize(
    ("kind", "line", "expected"),
    [
        ("motor", "", True),
        ("motor", "s", False),
        ("turns", "-0.5", -0.5),
        ("turns", "1,5", 1.5),
        ("degrees", "12 deg", 12.0),
        ("yes", "y", True),
        ("yes", "no", False),
        ("joint", "n", None),
        ("joint", "2", "right_drive_propulsion"),
    ],
)
def test_answers_at_the_terminal(
    folder: Path,
    kind: str,
    line: str,
    expected: object,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    robot = compile_file(folder / "robot.yaml").model
    assert isinstance(robot, Robot)
    monkeypatch.setattr("sys.stdin", Lines())
    operator = ConsoleOperator(robot)
    operator.ask(Question(kind, "What?", Axis(driven_joints(robot)[0], 0, "left")))
    assert operator.answer() is None
    operator.put("nonsense 7s")
    assert operator.answer() is None
    assert "this is no answer" in capsys.readouterr().err
    operator.put(line)
    answer = operator.answer()
    assert answer is not None
    assert getattr(answer[0], "name", answer[0]) == expected


def test_the_person_at_the_terminal_is_told_at_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = compile_file(folder / "robot.yaml").model
    assert isinstance(robot, Robot)
    monkeypatch.setattr("sys.stdin", Lines())
    ConsoleOperator(robot).alarm("cut the power: wheel left_wheel")
    assert "\ncut the power: wheel left_wheel\n" in capsys.readouterr().err


def test_the_picture_marks_the_wheel_and_fits_in_80_columns(folder: Path) -> None:
    robot = compile_file(folder / "robot.yaml").model
    assert isinstance(robot, Robot)
    picture = plan_view(robot, "right_wheel")
    assert ">>[2]<<" in picture
    assert max(map(len, picture.splitlines())) < 80
    front, back = picture.index("[2]"), picture.index("[3]")
    assert front < back


def test_a_report_of_a_killed_program_says_that_it_was_interrupted(
    thorvaldc: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, written = commission_page.write_report, []

    def record(path: Path, robot: Robot, report: CommissionReport) -> None:
        write(path, robot, report)
        written.append(json.loads(path.read_text(encoding="utf-8")))

    monkeypatch.setattr(commission_page, "write_report", record)
    assert (
        thorvaldc("can", "commission", str(folder / "robot.yaml"), "--bus", "virtual").status == 0
    )
    *before_the_end, last = written
    assert len(before_the_end) >= 3
    for report in before_the_end:
        assert report["interruption"] == "the program ended before all checks"
        assert not report["passed"]
    assert (last["interruption"], last["passed"]) == ("", True)
