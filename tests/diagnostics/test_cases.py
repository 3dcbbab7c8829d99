"""Tests every diagnostic code with files that raise it and similar files that do not.

The files are on the pages of the codes, see ``cases``.  A case has a command, ``run``:

- ``compile`` (default);
- ``emit`` to all targets, or to ``targets``;
- ``fresh``: compare build/NAME with a build; ``built``: whether it was built before;
- ``pin``: write the lock file, into a folder that may be ``read_only``;
- ``sim``: simulate ``twist`` for ``seconds``, with the parameter sets ``parameters``;
- ``bus``: run the simulated bus with the injected faults of faults.yaml;
- ``can``: configure the simulated bus in a ``situation``;
- ``interface``: open the CAN interface ``bus`` for the first bus of the robot;
- ``drive``: run the base driver on simulated buses, whose devices are those of the robot or
  of the file ``devices``, with the injected faults of faults.yaml;
- ``scenario``;
- ``demo``: run the demo of the build folder ``entry``;
- ``log``: read joints.csv, or record it first with the arguments ``record``;
- a command of a tool, which ``tests/tools/<tool>/diagnostic_cases.py`` runs.
"""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from collections.abc import Callable, Collection, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from tests.diagnostics.cases import GOOD, PAGES, read_cases
from thorvaldc.diagnostics import CODES, Diagnostic, Report
from thorvaldc.diagnostics.report import explain
from thorvaldc.model import Robot
from thorvaldc.model.model_json import VERSION

HERE = Path(__file__).parent
KEYS = {
    *("code", "at", "file", "files", "good", "entry", "run", "targets"),
    *("twist", "seconds", "parameters", "record", "distance", "read_only"),
    *("bus", "devices", "options", "situation", "git", "path", "built", "set"),
}
xdist_group = pytest.mark.xdist_group

Runner = Callable[[dict[str, Any], str], Iterable[Diagnostic]]
TOOL_COMMANDS: dict[str, Runner] = {}
for _file in sorted(HERE.parent.glob("tools/*/diagnostic_cases.py")):
    TOOL_COMMANDS |= import_module(f"tests.tools.{_file.parent.name}.diagnostic_cases").COMMANDS
# In a copy of the core without its tools, the cases of their commands cannot run.
CORE_COMMANDS = {
    *("compile", "emit", "fresh", "pin", "sim", "bus", "can", "interface", "drive"),
    *("commissioned", "scenario", "demo", "log"),
}


def can_run(case: dict[str, Any]) -> bool:
    """Returns whether the tool of a case is there: a copy of the core has none."""
    of_a_tool = case.get("run", "compile") not in CORE_COMMANDS or "study.yaml" in case["files"]
    return bool(TOOL_COMMANDS) or not of_a_tool


def cases(left_out: Collection[str] = (), step: int = 1) -> Any:
    """Runs a test with each case whose command is none of ``left_out``.

    The first case of each ``step``-th code is quick.  The cases of one code run in one process, see
    ``diagnostics_of``.
    """
    parameters = []
    for index, code in enumerate(CODES.values()):
        for number, page_case in enumerate(read_cases(PAGES / f"{code.number}.md")):
            case = {"code": code.name, **page_case}
            if case.get("run", "compile") in left_out or not can_run(case):
                continue
            marks = [xdist_group(code.number)]
            if number > 0 or index % step > 0:
                marks.append(pytest.mark.slow)
            name = f"{code.number}-{code.name}[{number}]"
            parameters.append(pytest.param(case, id=name, marks=marks))
    return pytest.mark.parametrize("case", parameters)


def bytes_of(content: Any) -> bytes:
    """Returns the bytes of a file of a case."""
    if isinstance(content, dict):
        content = content["repeat"] * content["times"]
    if isinstance(content, bytes):
        return content
    return content.replace("MODEL_VERSION", str(VERSION)).encode()


def write(files: dict[str, Any], folder: Path) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes_of(content))


_known_diagnostics: dict[str, list[Diagnostic]] = {}


def diagnostics_of(files: dict[str, Any], case: dict[str, Any]) -> list[Diagnostic]:
    """Returns the diagnostics of the command of a case on ``files`` in a folder of their own.

    Equal commands on equal files run once in a process: many cases have the same good files,
    and the fix of a hint often makes them.
    """
    described = ("code", "at", "file", "files", "good")
    command = {k: v for k, v in case.items() if k not in described and GOOD not in k}
    key = repr((sorted(files.items()), sorted(command.items())))
    if key not in _known_diagnostics:
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            write(files, Path())
            _known_diagnostics[key] = run_case(case, case.get("entry", "robot.yaml"))
    return _known_diagnostics[key]


def check_build(compilation: Any, case: dict[str, Any]) -> None:
    from thorvaldc.compiler.output.build_freshness import check_freshness
    from thorvaldc.compiler.output.writer import write_build
    from thorvaldc.compiler.pipeline import emit

    files = emit(compilation.model, ["urdf"])
    name, folder = compilation.model.name, Path("build") / compilation.model.name
    if case.get("built"):
        digest = compilation.source_sha256
        write_build(files, folder, name=name, source_sha256=digest, version="1")
    check_freshness(compilation, files, folder, file="robot.yaml", command="", version="1")


def run_case(case: dict[str, Any], entry: str) -> list[Diagnostic]:
    """Runs the command of a case in the working folder; returns the diagnostics."""
    command = case.get("run", "compile")
    if command in TOOL_COMMANDS:
        return list(TOOL_COMMANDS[command](case, entry))
    if command == "demo":
        from thorvaldc.simulation.simulation_run import drive_build

        report = Report()
        drive_build(Path(entry), report)
        return list(report)
    from thorvaldc.backends import DEFAULT_TARGETS
    from thorvaldc.compiler.pipeline import compile_file, emit

    compilation = compile_file(entry, set=case.get("set"))
    if command == "emit" and compilation.model is not None:
        emit(compilation.model, case.get("targets", DEFAULT_TARGETS), compilation.report)
    if command == "fresh":
        check_build(compilation, case)
    if command == "pin":
        from thorvaldc.compiler.output.writer import write_locks

        os.chmod(".", 0o555 if case.get("read_only") else 0o755)
        try:
            write_locks(compilation.locks, compilation.report)
        finally:
            os.chmod(".", 0o755)
    if command == "scenario" and compilation.scenario is not None:
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        report = Report()
        files = emit(compilation.scenario.fleet, ["mjcf"], report)
        ScenarioSimulation(compilation.scenario, files).play(report)
        compilation.report.extend(compilation.located(report))
    if command == "sim" and compilation.model is not None:
        from thorvaldc.diagnostics import DiagnosticError
        from thorvaldc.runtime.se2 import Twist
        from thorvaldc.simulation.simulation_run import Simulation

        try:
            files = emit(compilation.model, ["mjcf"], compilation.report)
            simulation = Simulation(compilation.model, files, case.get("parameters"))
            twist = Twist(*map(float, case["twist"].split(",")))
            simulation.run(case.get("seconds", 0.1), twist, compilation.report)
        except DiagnosticError as error:
            compilation.report.put(error.diagnostic)
    if command == "bus" and isinstance(compilation.model, Robot):
        run_on_a_bus(compilation.model, compilation.report)
    if command == "drive" and isinstance(compilation.model, Robot):
        drive_by_its_buses(compilation.model, case.get("devices"), compilation.report)
    if command == "can" and isinstance(compilation.model, Robot):
        from tests.commissioning.situations import play
        from thorvaldc.diagnostics import DiagnosticError

        try:
            play(compilation.model, case["situation"])
        except DiagnosticError as error:
            compilation.report.put(error.diagnostic)
    if command == "commissioned" and isinstance(compilation.model, Robot):
        demand_report(compilation.model, compilation.report)
    if command == "interface" and isinstance(compilation.model, Robot):
        from thorvaldc.can.open_interface import open_interface
        from thorvaldc.diagnostics import DiagnosticError

        try:
            open_interface(case["bus"], compilation.model.buses[0]).close()
        except DiagnosticError as error:
            compilation.report.put(error.diagnostic)
    if command == "log" and isinstance(compilation.model, Robot):
        from tests.recording import logged

        logged(compilation.model, case, compilation.report)
    return list(compilation.report)


def demand_report(robot: Robot, report: Report) -> None:
    """Demands the report of `can commission` as a run does; KEY in it is that of its motor."""
    from thorvaldc.commissioning import commission_report
    from thorvaldc.commissioning.scan_result import OK, FoundDevice, ScanEntry
    from thorvaldc.diagnostics import DiagnosticError

    path = Path(f"robot{commission_report.SUFFIX}")
    if path.exists():
        text = path.read_text(encoding="utf-8")
        for motor in commission_report.driven_joints(robot):
            text = text.replace("KEY", commission_report.motor_key(robot, motor), 1)
        path.write_text(text, encoding="utf-8")
    devices = [
        ScanEntry(n.name, OK, n.id, FoundDevice(n.id)) for bus in robot.buses for n in bus.nodes
    ]
    try:
        checked = commission_report.read_report(path)
        commission_report.require_commissioned(path, checked, robot, devices)
    except DiagnosticError as error:
        report.put(error.diagnostic)


def run_on_a_bus(robot: Robot, report: Report) -> None:
    from thorvaldc.compiler.bus.injected_faults import read_faults
    from thorvaldc.diagnostics import DiagnosticError
    from thorvaldc.simulation.bus.fault_injection import FaultInjector
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    script = read_faults("faults.yaml", robot, report)
    try:
        simulated = SimulatedRobot(robot)
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return
    if script is not None:
        FaultInjector(simulated, script)
        simulated.power_on()
        simulated.run(0.3)


def drive_by_its_buses(robot: Robot, devices: str | None, report: Report) -> None:
    """Runs the base driver for a second on simulated devices of ``robot`` or of ``devices``."""
    from thorvaldc.compiler.bus.injected_faults import read_faults
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.diagnostics import DiagnosticError
    from thorvaldc.runtime.run_session import RunSession
    from thorvaldc.simulation.bus.fault_injection import FaultInjector
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    simulated_model = compile_file(devices).model if devices is not None else robot
    assert isinstance(simulated_model, Robot)
    simulated = SimulatedRobot(simulated_model)
    if Path("faults.yaml").exists():
        script = read_faults("faults.yaml", robot, report)
        assert script is not None
        FaultInjector(simulated, script)
    simulated.power_on()
    interfaces = {bus.name: simulated.interface(bus.name) for bus in robot.buses}
    try:
        session = RunSession(robot, interfaces, duration=5.0, threaded=False)
    except DiagnosticError as error:
        report.put(error.diagnostic)
        return
    diagnostic = session.run()
    if diagnostic is not None:
        report.put(diagnostic)


@cases()
def test_case(case: dict[str, Any]) -> None:
    assert {key.removeprefix(GOOD) for key in case} <= KEYS, "unknown key in a case"
    diagnostics = diagnostics_of(case["files"], case)
    expected = [d for d in diagnostics if d.code.name == case["code"]]
    shown = [(d.code.name, str(d.span), d.message) for d in diagnostics]
    assert expected, f"not raised; instead: {shown}"
    assert any(is_at(d, case) for d in expected), f"raised at another line: {shown}"


def is_at(diagnostic: Diagnostic, case: dict[str, Any]) -> bool:
    """Returns whether a diagnostic is ``at`` the line of a case."""
    span, at = diagnostic.span, case["at"]
    if span is None or at == "nowhere":
        return span is None and at == "nowhere"
    if isinstance(at, int):
        return span.line == at
    if span.file != case.get("file", span.file) or span.file not in case["files"]:
        return False
    lines = re.split(r"\r\n?|\n", bytes_of(case["files"][span.file]).decode(errors="replace"))
    return at in lines[span.line - 1]


@cases(step=8)
def test_good_files(case: dict[str, Any]) -> None:
    arguments = {k.removeprefix(GOOD): v for k, v in case.items() if k.startswith(GOOD)}
    unexpected = [
        (d.code.name, str(d.span), d.message)
        for d in diagnostics_of(case["good"], {**case, **arguments})
        if d.code.name == case["code"] or d.code.severity == "error"
    ]
    assert not unexpected


@pytest.mark.parametrize("code", list(CODES.values()), ids=lambda code: code.number)
def test_every_code_has_a_page_with_cases(code: Any) -> None:
    page = PAGES / f"{code.number}.md"
    assert page.is_file(), f"there is no page {page.name}"
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"# {code.number} {code.name}\n\n")
    assert re.findall("^## .*", text, re.M) == ["## How to fix it", "## Examples"]
    cases = read_cases(page)
    assert cases
    assert text.count("<!-- case") == len(cases)
    shown = explain(code.number)
    assert "<!-- case" not in shown
    assert shown.partition("\n## Examples\n")[2].strip(), "no example is shown"


def test_pages_belong_to_codes() -> None:
    numbers = {code.number for code in CODES.values()}
    assert [path.stem for path in PAGES.glob("TV*.md") if path.stem not in numbers] == []


def test_numbers_and_names_are_used_once() -> None:
    codes = list(CODES.values())
    assert len({code.number for code in codes}) == len(codes)
    assert len({code.name for code in codes}) == len(codes)
