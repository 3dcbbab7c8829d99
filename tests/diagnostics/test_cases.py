"""Every code is raised by its cases, at the line they say, and not by their neighbours.

A case file ``TVnnn-name.yaml`` is a list of cases:

- ``code``: the name of the code that must be raised;
- ``line``: where, 0 for a fault without a place; ``file``: in which file (default: any);
- ``files``: the documents by path, as text, ``!!binary``, or ``{repeat: text, times: n}``;
- ``neighbour``: files that differ as little as may be and compile without errors;
- ``entry``: the file to compile (default ``robot.yaml``);
- ``run``: ``compile`` (default), ``emit`` (to all targets or to ``targets``), ``pin`` (write
  the lock file, into a folder that is ``read_only`` or not), ``sim`` (with ``twist`` for
  ``seconds`` by ``parameters``), ``bus`` (with the faults of faults.yaml),
  ``can`` (setting its simulated bus up in a ``situation``), ``port`` (opening ``bus`` for its
  first bus), ``drive`` (by its buses with
  ``devices`` of another file, and faults.yaml), ``scenario``,
  ``demo`` (of the build folder ``entry``), ``import``, or ``log`` and ``calibrate`` (reading
  joints.csv, which ``record`` makes by its arguments, and calibrating by it, with
  ``distance``), or ``replay`` (of record.csv, by the command with ``options``);
- keys of a neighbour's own run, such as ``neighbour_twist``, where they differ.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from thorvaldc.diagnostics import CODES, Diagnostic, Report
from thorvaldc.model import Robot

HERE = Path(__file__).parent
PAGES = HERE.parent.parent / "docs" / "diagnostics"
KEYS = {
    *("code", "line", "file", "files", "neighbour", "entry", "run", "targets"),
    *("twist", "seconds", "parameters", "record", "distance", "read_only"),
    *("bus", "devices", "options", "situation"),
}
OWN = "neighbour_"


def case_files() -> list[Path]:
    return sorted(HERE.glob("*.yaml"))


def cases() -> Iterator[Any]:
    for path in case_files():
        for number, case in enumerate(yaml.safe_load(path.read_text(encoding="utf-8"))):
            yield pytest.param(case, id=f"{path.stem}[{number}]")


def write(files: dict[str, Any], folder: Path) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, dict):
            content = content["repeat"] * content["times"]
        path.write_bytes(content if isinstance(content, bytes) else content.encode())


def faults(case: dict[str, Any], entry: str) -> list[Diagnostic]:
    """What is found in the files in the working folder."""
    how = case.get("run", "compile")
    if how == "import":
        from thorvaldc.compiler.importer import import_original

        return list(import_original(Path(entry))[1])
    if how == "demo":
        from thorvaldc.simulation.simulation_run import run_demo

        report = Report()
        run_demo(Path(entry), report)
        return list(report)
    from thorvaldc.backends import DEFAULT_TARGETS
    from thorvaldc.compiler.pipeline import compile_file, emit

    done = compile_file(entry)
    if how == "emit" and done.model is not None:
        emit(done.model, case.get("targets", DEFAULT_TARGETS), done.report)
    if how == "pin":
        from thorvaldc.compiler.writer import write_locks

        os.chmod(".", 0o555 if case.get("read_only") else 0o755)
        try:
            write_locks(done.locks, done.report)
        finally:
            os.chmod(".", 0o755)
    if how == "scenario" and done.scenario is not None:
        from thorvaldc.simulation.scenario_run import ScenarioSimulation

        found = Report()
        files = emit(done.scenario.fleet, ["mjcf"], found)
        ScenarioSimulation(done.scenario, files).play(found)
        done.report.extend(done.located(found))
    if how == "sim" and done.model is not None:
        from thorvaldc.diagnostics.error import DiagnosticError
        from thorvaldc.runtime.twist_text import parse_twist
        from thorvaldc.simulation.simulation_run import Simulation

        try:
            files = emit(done.model, ["mjcf"], done.report)
            simulation = Simulation(done.model, files, case.get("parameters"))
            simulation.run(case.get("seconds", 0.1), parse_twist(case["twist"]), done.report)
        except DiagnosticError as fault:
            done.report.put(fault.diagnostic)
    if how == "bus" and isinstance(done.model, Robot):
        run_on_a_bus(done.model, done.report)
    if how == "drive" and isinstance(done.model, Robot):
        drive_by_its_buses(done.model, case.get("devices"), done.report)
    if how == "can" and isinstance(done.model, Robot):
        from tests.commissioning.situations import play
        from thorvaldc.diagnostics.error import DiagnosticError

        try:
            play(done.model, case["situation"])
        except DiagnosticError as fault:
            done.report.put(fault.diagnostic)
    if how == "port" and isinstance(done.model, Robot):
        from thorvaldc.can.open_interface import open_interface
        from thorvaldc.diagnostics.error import DiagnosticError

        try:
            open_interface(case["bus"], done.model.buses[0]).close()
        except DiagnosticError as fault:
            done.report.put(fault.diagnostic)
    if how == "replay" and isinstance(done.model, Robot):
        from thorvaldc.cli.picturing import RunPictures
        from thorvaldc.cli.replaying import read_enough

        pictures = RunPictures(*case.get("options", [""]))
        read_enough("record.csv", [(done.model.name, done.model)], pictures, done.report)
    if how in ("log", "calibrate") and isinstance(done.model, Robot):
        calibrate(done.model, case, done.report)
    return list(done.report)


def run_on_a_bus(robot: Robot, report: Report) -> None:
    from thorvaldc.compiler.pipeline import read_faults
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.simulation.bus.fault_injection import FaultInjector
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    script = read_faults("faults.yaml", robot, report)
    try:
        simulated = SimulatedRobot(robot)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        return
    if script is not None:
        FaultInjector(simulated, script)
        simulated.power_on()
        simulated.run(0.3)


def drive_by_its_buses(robot: Robot, devices: str | None, report: Report) -> None:
    """Start it and stand for a second, on the devices of the robot's file or of another."""
    from thorvaldc.cli.running import Session
    from thorvaldc.compiler.pipeline import compile_file, read_faults
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.simulation.bus.fault_injection import FaultInjector
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    other = compile_file(devices).model if devices is not None else robot
    assert isinstance(other, Robot)
    simulated = SimulatedRobot(other)
    if Path("faults.yaml").exists():
        script = read_faults("faults.yaml", robot, report)
        assert script is not None
        FaultInjector(simulated, script)
    simulated.power_on()
    ports = {bus.name: simulated.interface(bus.name) for bus in robot.buses}
    try:
        session = Session(robot, ports, simulated, "", None, 5.0, fast=True)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        return
    ended = session.play(False)
    if ended is not None:
        report.put(ended)


def calibrate(robot: Robot, case: dict[str, Any], report: Report) -> None:
    from tests.recording import record
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.simulation.records.joint_csv import read_log
    from thorvaldc.tools.calibration import self_calibration as calibration

    path = Path("joints.csv")
    if "record" in case:
        try:
            path.write_text(record(robot, **case["record"]), encoding="utf-8")
        except DiagnosticError as fault:
            report.put(fault.diagnostic)
            return
    log = read_log(path, path.name, robot, report)
    if log is not None and case["run"] == "calibrate":
        calibration.calibrate(robot, log, report, case.get("distance"), path.name)


@pytest.mark.parametrize("case", list(cases()))
def test_case(case: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert {key.removeprefix(OWN) for key in case} <= KEYS, "a case has no such key"
    entry = case.get("entry", "robot.yaml")
    write(case["files"], tmp_path)
    monkeypatch.chdir(tmp_path)
    found = faults(case, entry)
    said = [(d.code.name, str(d.span), d.message) for d in found]
    mine = [d for d in found if d.code.name == case["code"]]
    assert mine, f"not raised; instead: {said}"
    places = [(d.span.file, d.span.line) if d.span is not None else ("", 0) for d in mine]
    if "file" not in case:
        places = [(case.get("file", ""), line) for _, line in places]
    assert (case.get("file", ""), case["line"]) in places, f"raised elsewhere: {said}"


@pytest.mark.parametrize("case", list(cases()))
def test_neighbour(case: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(case["neighbour"], tmp_path)
    monkeypatch.chdir(tmp_path)
    case = {**case, **{k.removeprefix(OWN): v for k, v in case.items() if k.startswith(OWN)}}
    found = faults(case, case.get("entry", "robot.yaml"))
    wrong = [
        (d.code.name, str(d.span), d.message)
        for d in found
        if d.code.name == case["code"] or d.code.severity == "error"
    ]
    assert not wrong


@pytest.mark.parametrize("code", list(CODES.values()), ids=lambda code: code.number)
def test_every_code_has_cases_and_a_page(code: Any) -> None:
    path = HERE / f"{code.number}-{code.name}.yaml"
    assert path.is_file(), f"there is no case file {path.name}"
    found = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert found
    for case in found:
        assert case["code"] == code.name
        assert case["neighbour"]
    page = PAGES / f"{code.number}.md"
    assert page.is_file(), f"there is no page {page.name}"
    lines = page.read_text(encoding="utf-8").splitlines()
    assert lines[0] == f"# {code.number} {code.name}"
    assert len([line for line in lines if line.startswith("## ")]) >= 3
    assert 10 <= len(lines) <= 30


def test_files_belong_to_codes() -> None:
    known = {f"{code.number}-{code.name}" for code in CODES.values()}
    assert [path.stem for path in case_files() if path.stem not in known] == []
    numbers = {code.number for code in CODES.values()}
    assert [path.stem for path in sorted(PAGES.glob("TV*.md")) if path.stem not in numbers] == []


def test_numbers_and_names_are_used_once() -> None:
    codes = list(CODES.values())
    assert len({code.number for code in codes}) == len(codes)
    assert len({code.name for code in codes}) == len(codes)
