"""The devices on the buses of a computer, compared with the file that is to be installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.cli.test_bus import running
from tests.cli.test_can import FRONT_RIGHT, TWO_BUSES
from tests.simulation.bus.robots import CIA402, compiled
from thorvaldc.can.open_interface import bus_lock
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.model import Robot
from thorvaldc.model.robot_computer import CanAdapter
from thorvaldc.simulation.bus.bus_server import serving
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.tools.computer.answering_devices import Answers, compare_devices


@pytest.fixture(scope="module")
def shed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder with the bus of a robot."""
    folder = tmp_path_factory.mktemp("bus")
    (folder / "robot.yaml").write_text(CIA402, encoding="utf-8")
    with running(folder, "robot.yaml", "--channel", "shed"):
        yield folder


def answers(robot: Robot, spec: str, monkeypatch: pytest.MonkeyPatch) -> Answers:
    """``spec``: CAN interface of each bus; `{bus}` stands for the name of the bus."""
    monkeypatch.setattr(CanAdapter, "spec", property(lambda a: spec.format(bus=a.bus)))
    return compare_devices(robot)


IDENTITY = "vendor 0x0, product 0x192, revision 0x10000, serial 0x10"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({}, []),
        (
            {'"0x103"': '"0x777"'},
            [
                f"the device with the id 3 on the bus `main` is {IDENTITY}3; in the file,"
                " `rl_controller` is vendor 0x0, product 0x192, revision 0x10000, serial 0x777"
            ],
        ),
        ({'"0x10': '"0x50'}, [f"with the id {number} on" for number in (1, 2, 3, 4)]),
        (
            {'id: 4, serial: "0x104"': 'id: 5, serial: "0x504"'},
            [f"id 4 on the bus `main` is {IDENTITY}4; the robot file does not name it"],
        ),
    ],
)
def test_devices_of_another_robot(
    shed: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, str], messages: list[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shed))
    text = CIA402
    for old, new in changes.items():
        text = text.replace(old, new)
    report, notes = answers(compiled(text), "sim:shed", monkeypatch)
    assert [e.code.name for e in report] == ["bus-wrong-robot"] * len(messages)
    assert all(part in e.message for part, e in zip(messages, report, strict=True))
    assert notes == [f"{7 - len(messages)} of 7 devices on the bus `main` are as in the file"]


def test_what_to_do_after_a_replacement(shed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shed))
    robot = compiled(CIA402.replace('"0x103"', '"0x777"'))
    (error,) = answers(robot, "sim:shed", monkeypatch).report
    node = next(n for n in robot.buses[0].nodes if n.name == "rl_controller")
    assert (error.span, error.span.line) == (node.span, 17)
    assert error.hint is not None
    assert "nothing was installed; is it the file of this robot?" in error.hint
    assert 'if `rl_controller` was replaced, write `serial: "0x103"`' in error.hint


def test_a_bus_in_use_or_without_interface_is_not_asked(
    shed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is that of another robot, which a question would reveal."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shed))
    other = compiled(CIA402.replace('"0x10', '"0x50'))
    with bus_lock("sim:shed"):  # as the base driver does
        report, (note,) = answers(other, "sim:shed", monkeypatch)
    assert "`main` were not compared with the file: another `thorvaldc can` or" in note
    assert not list(report)
    for spec, reason in (
        ("sim:barn", "cannot use the bus `sim:barn`"),
        ("socketcan:no_such_can", "there is no network interface no_such_can"),
    ):
        report, (note,) = answers(other, spec, monkeypatch)
        assert "were not compared with the file: " in note
        assert reason in note
        assert not list(report)


def test_a_bus_without_power_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulated = SimulatedRobot(compiled(CIA402))
    path = str(tmp_path / "bus")
    with serving(simulated.timeline, {path: simulated.wire()}):
        report, (note,) = answers(simulated.robot, f"sim:{path}", monkeypatch)
        assert not list(report)
        assert "the interface is error-passive: frames do not reach the devices" in note
        with closing(SimulatedBusClient(path, "listener", 500_000)):  # acknowledges the requests
            report, (note,) = answers(simulated.robot, f"sim:{path}", monkeypatch)
    assert not list(report)
    assert note == "nothing answered on the bus `main`: its devices may have no power"


@pytest.mark.slow
def test_exchanged_adapters_are_one_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = TWO_BUSES.replace("fr: {type: caster/swivel, mount: frame.front_right}", FRONT_RIGHT)
    robot = compiled(text.replace("{id: 1,", "{bus: left, id: 1,"))
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    wires = {
        str(tmp_path / "left"): simulated.wires["right"],
        str(tmp_path / "right"): simulated.wires["left"],
    }
    with serving(simulated.timeline, wires):
        report, _ = answers(robot, f"sim:{tmp_path}/{{bus}}", monkeypatch)
    (error,) = report
    assert error.message == "the buses `left` and `right` are exchanged"
