"""Tests every diagnostic code with example files that raise it and similar files that do not.

A case file ``TVnnn-name.yaml`` is a list of cases:

- ``code``: name of the expected code;
- ``line``: line of the diagnostic, 0 if it has no span; ``file``: its file (default: any);
- ``files``: the documents by path, as text, ``!!binary``, or ``{repeat: text, times: n}``; in a
  text, MODEL_VERSION is the version of model.json;
- ``change``: the smallest change of the files that removes the diagnostic, by path: lines of the
  file that begin with a space, lines that go (``-``), and lines that come (``+``); a line ``@@``
  begins another place.  The lines of a place are in the file once;
- ``neighbour``: the changed files, where they have more than other lines;
- ``entry``: the file to compile (default ``robot.yaml``);
- ``run``: the command to test:

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
  - a command of a tool, which ``tests/tools/<tool>/diagnostic_cases.py`` runs;

- ``neighbour_<key>``: value of a key for the neighbour, such as ``neighbour_twist``.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import re
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

from thorvaldc.diagnostics import CODES, Diagnostic, Report
from thorvaldc.model import Robot
from thorvaldc.model.model_json import VERSION

HERE = Path(__file__).parent
PAGES = HERE.parent.parent / "docs" / "diagnostics"
KEYS = {
    *("code", "line", "file", "files", "neighbour", "entry", "run", "targets"),
    *("twist", "seconds", "parameters", "record", "distance", "read_only"),
    *("bus", "devices", "options", "situation", "git", "path", "built"),
}
NEIGHBOUR = "neighbour_"
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


def case_files() -> list[Path]:
    return sorted(HERE.glob("*.yaml"))


@functools.cache
def read_cases(path: Path) -> list[dict[str, Any]]:
    cases: list[dict[str, Any]] = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)
    for case in cases:
        if "change" in case:
            changes, files = case.pop("change"), case["files"]
            changed = {file: with_change(files[file], text) for file, text in changes.items()}
            case["neighbour"] = {**files, **changed}
    return cases


def with_change(text: str, change: str) -> str:
    """Returns a text with other lines.  Raises ``ValueError`` if they are not there once."""
    lines = text.splitlines(keepends=True)
    for place in re.split(r"^@@\n", change, flags=re.MULTILINE):
        marked = [(line[0], line[1:]) for line in place.splitlines(keepends=True)]
        old = [line for mark, line in marked if mark != "+"]
        starts = [i for i in range(len(lines)) if lines[i : i + len(old)] == old]
        if len(starts) != 1:
            raise ValueError(f"{len(starts)} places have these lines: {place}")
        lines[starts[0] : starts[0] + len(old)] = [line for mark, line in marked if mark != "-"]
    return "".join(lines)


def can_run(case: dict[str, Any]) -> bool:
    """Returns whether the tool of a case is there: a copy of the core has none."""
    of_a_tool = case.get("run", "compile") not in CORE_COMMANDS or "study.yaml" in case["files"]
    return bool(TOOL_COMMANDS) or not of_a_tool


def cases(left_out: Collection[str] = (), step: int = 1) -> Any:
    """Runs a test with each case whose command is none of ``left_out``.

    The first case of each ``step``-th file is quick.  The cases of one file run in one process, see
    ``diagnostics_of``.
    """
    parameters = []
    for index, path in enumerate(case_files()):
        for number, case in enumerate(read_cases(path)):
            if case.get("run", "compile") in left_out or not can_run(case):
                continue
            marks = [xdist_group(path.stem)]
            if number > 0 or index % step > 0:
                marks.append(pytest.mark.slow)
            parameters.append(pytest.param(case, id=f"{path.stem}[{number}]", marks=marks))
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

    Equal commands on equal files run once in a process: many cases have the same neighbour, and
    the fix of a hint often makes the neighbour.
    """
    described = ("code", "line", "file", "files", "neighbour")
    command = {k: v for k, v in case.items() if k not in described and NEIGHBOUR not in k}
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

    compilation = compile_file(entry)
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
    assert {key.removeprefix(NEIGHBOUR) for key in case} <= KEYS, "unknown key in a case"
    diagnostics = diagnostics_of(case["files"], case)
    shown = [(d.code.name, str(d.span), d.message) for d in diagnostics]
    expected = [d for d in diagnostics if d.code.name == case["code"]]
    assert expected, f"not raised; instead: {shown}"
    lines = [(d.span.file, d.span.line) if d.span is not None else ("", 0) for d in expected]
    if "file" not in case:
        lines = [("", line) for _, line in lines]
    assert (case.get("file", ""), case["line"]) in lines, f"raised at another line: {shown}"


@cases(step=8)
def test_neighbour(case: dict[str, Any]) -> None:
    case = {
        **case,
        **{k.removeprefix(NEIGHBOUR): v for k, v in case.items() if k.startswith(NEIGHBOUR)},
    }
    unexpected = [
        (d.code.name, str(d.span), d.message)
        for d in diagnostics_of(case["neighbour"], case)
        if d.code.name == case["code"] or d.code.severity == "error"
    ]
    assert not unexpected


@pytest.mark.parametrize("code", list(CODES.values()), ids=lambda code: code.number)
def test_every_code_has_cases_and_a_page(code: Any) -> None:
    path = HERE / f"{code.number}-{code.name}.yaml"
    assert path.is_file(), f"there is no case file {path.name}"
    assert read_cases(path)
    for case in read_cases(path):
        assert case["code"] == code.name
        assert case["neighbour"]
    page = PAGES / f"{code.number}.md"
    assert page.is_file(), f"there is no page {page.name}"
    lines = page.read_text(encoding="utf-8").splitlines()
    assert lines[0] == f"# {code.number} {code.name}"
    assert len([line for line in lines if line.startswith("## ")]) >= 3
    assert 10 <= len(lines) <= 30


# Pages whose example no test can try: words, commands, or files that the cases do not have. The
# example of a new page must raise its code: this list only becomes shorter.
UNTRIED = """
    102 103 536 732 734 772 803 804 806 807 808 809 810 811 821 822 825 831 835 836 837 838 839
    840 841 853 854 860 861 862 863 864 865 866 867 868 869 870 875 876 878 879 880 881 901 902 903
    940 941 942 949 963 970 971 972 973 974 985
"""
LEFT_OUT = re.compile(r"<!--.*?-->|#.*|[\s\"']+")
GOOD = """
thorvaldc: 1
name: good
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1, width: 0.9}}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0, 0.07]}}
"""


def test_the_example_of_a_page_raises_its_code() -> None:
    """An example has its lines from a case, or its sections raise the code in a good file."""
    silent, tried = set[str](), set[str]()
    for code in CODES.values():
        page = (PAGES / f"{code.number}.md").read_text(encoding="utf-8")
        section = page.partition("## An example that raises it\n")[2].partition("\n## ")[0]
        language, _, example = section.partition("```")[2].partition("```")[0].partition("\n")
        cases = list(filter(can_run, read_cases(HERE / f"{code.number}-{code.name}.yaml")))
        texts = LEFT_OUT.sub("", "".join(str(t) for case in cases for t in case["files"].values()))
        is_of_a_case = all(LEFT_OUT.sub("", line) in texts for line in example.splitlines())
        robots = [*cases, {"neighbour": {"robot.yaml": GOOD}}]
        if not example or not (
            is_of_a_case
            or (language == "yaml" and any(raises(code.name, example, case) for case in robots))
        ):
            silent.add(code.number.removeprefix("TV"))
        if cases:
            tried.add(code.number.removeprefix("TV"))
    assert silent & tried == set(UNTRIED.split()) & tried


def raises(name: str, example: str, case: dict[str, Any]) -> bool:
    """Returns whether an example raises a code in one of the good files of a case."""
    for file, text in case["neighbour"].items():
        if not isinstance(text, str) or not file.endswith((".yaml", ".yml")):
            continue
        for changed in with_example(text, example):
            with contextlib.suppress(Exception):  # a file that the command does not expect
                diagnostics = diagnostics_of({**case["neighbour"], file: changed}, case)
                if name in {diagnostic.code.name for diagnostic in diagnostics}:
                    return True
    return False


def with_example(text: str, example: str) -> Iterator[str]:
    """Yields a file whose sections the example replaces, then those in which it is a part."""
    replaced = set(re.findall(r"^([\w.]+):", example, re.M))
    sections = re.split(r"^(?=[\w.]+:)", text, flags=re.M)
    kept = [section for section in sections if section.partition(":")[0] not in replaced]
    yield "".join(kept).rstrip() + "\n" + example
    with contextlib.suppress(yaml.YAMLError):
        for changed in overlaid(yaml.safe_load(text), yaml.safe_load(example)):
            yield yaml.safe_dump(changed, sort_keys=False)


def overlaid(document: Any, part: Any) -> Iterator[Any]:
    """Yields copies of a document in which one mapping has the entries of ``part``."""
    if not isinstance(part, dict) or not isinstance(document, dict | list):
        return
    if isinstance(document, dict):
        yield merged(document, part)
    entries = document.items() if isinstance(document, dict) else enumerate(document)
    for key, entry in list(entries):
        if isinstance(entry, list) or (isinstance(entry, dict) and part.keys() & entry.keys()):
            inner = overlaid(entry, part)
        elif isinstance(entry, dict):
            inner = itertools.islice(overlaid(entry, part), 1, None)
        else:
            continue
        for changed in inner:
            copy = document.copy()
            copy[key] = changed
            yield copy


def merged(under: Any, over: Any) -> Any:
    """Merges mappings at all levels; a module of another type replaces the module."""
    if not isinstance(under, dict) or not isinstance(over, dict) or "type" in over:
        return over
    return {**under, **{key: merged(under.get(key), entry) for key, entry in over.items()}}


def test_files_belong_to_codes() -> None:
    known = {f"{code.number}-{code.name}" for code in CODES.values()}
    assert [path.stem for path in case_files() if path.stem not in known] == []
    numbers = {code.number for code in CODES.values()}
    assert [path.stem for path in sorted(PAGES.glob("TV*.md")) if path.stem not in numbers] == []


def test_numbers_and_names_are_used_once() -> None:
    codes = list(CODES.values())
    assert len({code.number for code in codes}) == len(codes)
    assert len({code.name for code in codes}) == len(codes)
