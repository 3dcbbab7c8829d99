"""Which of several files is that of the robot on the bus."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.commissioning.bench import QUICK, SWAPPED, Bench
from tests.commissioning.robots import without_serials
from tests.example_packages import PACKAGES
from tests.examples import example_robot
from tests.simulation.bus.robots import CIA402, cia402_robot, compiled
from thorvaldc.commissioning.identify import (
    Candidate,
    Match,
    identify,
    match_table,
    only_listens,
    verdict,
)
from thorvaldc.model import Robot

ROOT = Path(__file__).parents[2]
DRIVES = ("fl_controller", "fr_controller", "rl_controller", "rr_controller")


CIA402_OF_OTHERS = """
thorvaldc: 1
name: of_others
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, params:
    {controller: controller/cia402_propulsion_steering}, can: {id: 21, serial: "0x901"}}
  fr: {type: caster/swivel, mount: frame.front_right}
  rl: {type: caster/fixed, mount: frame.rear_left}
  rr: {type: caster/fixed, mount: frame.rear_right}
"""


def other_robot(number: int) -> Robot:
    """Returns a robot of the same design with other serial numbers."""
    text = CIA402.replace('"0x10', f'"0x{number}0').replace("with_cia402", f"robot_{number}")
    return compiled(text)


def candidates(*robots: Robot) -> list[Candidate]:
    return [Candidate(f"{r.name}/robot.yaml", r, r.buses[0]) for r in robots]


def matches_on(bench: Bench, robots: list[Candidate]) -> list[Match]:
    master = bench.master()
    try:
        return identify(master.interface, robots, timing=QUICK)
    finally:
        master.interface.close()


def bench(robot: Robot, **options: Any) -> Bench:
    return Bench(robot, delivered=False, timing=QUICK, **options)


def words(match: Match) -> str:
    return "\n".join(f"{d.node}: {d.text}; {d.change}" for d in match.differences)


def test_serial_numbers_decide_between_robots_of_one_design() -> None:
    robots = [other_robot(5), cia402_robot(), other_robot(7)]
    for robot in robots:
        first, *others = matches_on(bench(robot), candidates(*robots))
        assert first.candidate.robot is robot
        assert (first.ok, first.serials, first.differences) == (first.nodes, 4, ())
        assert verdict([first, *others]) == f"this is {robot.name}: {robot.name}/robot.yaml"
        assert {match.serials for match in others} == {0}
        assert all(len(match.differences) >= 4 for match in others)


def test_a_file_without_serial_numbers_fits_less_than_the_right_one() -> None:
    general = replace(without_serials(cia402_robot(), DRIVES), name="general")
    first, second = matches_on(bench(cia402_robot()), candidates(general, cia402_robot()))
    assert first.candidate.robot.name == "with_cia402"
    assert (second.serials, second.differences) == (0, ())


def test_two_equal_files_are_both_named() -> None:
    copy = replace(cia402_robot(), name="copy")
    found = matches_on(bench(cia402_robot()), candidates(copy, cia402_robot()))
    assert "match equally: copy/robot.yaml, with_cia402/robot.yaml" in verdict(found)


def test_none_of_the_files() -> None:
    two = compiled(CIA402_OF_OTHERS)
    (match,) = matches_on(bench(two), candidates(cia402_robot()))
    assert verdict([match]) == "none of the files is that of the robot on this bus", words(match)
    assert words(match).count("does not answer; look at its plugs and its power") == match.nodes


def test_a_replaced_drive_has_the_line_for_the_file() -> None:
    text = CIA402.replace('serial: "0x103"', 'serial: "0x1f3"')
    first, second = matches_on(bench(compiled(text)), candidates(cia402_robot(), other_robot(5)))
    assert first.candidate.robot.name == "with_cia402"
    assert first.serials == 3
    (difference,) = first.differences
    assert difference.node == "rl_controller"
    assert "at the id 3 of rl_controller is another device of its type" in difference.text
    assert 'write `serial: "0x1f3"` at robot.yaml:17' in difference.change
    assert "this is most likely with_cia402" in verdict([first, second])
    assert "1 difference" in verdict([first, second])


def test_exchanged_ids_and_a_drive_without_an_id_are_flashed() -> None:
    robot = cia402_robot()
    (match,) = matches_on(
        Bench(robot, {**SWAPPED, "rl_controller": {}}, delivered=False, timing=QUICK),
        candidates(robot),
    )
    text = words(match)
    assert "fl_controller (serial number 0x101) has the id 2, not 1" in text
    assert "fr_controller (serial number 0x102) has the id 1, not 2" in text
    assert match.serials >= 3
    assert all("can flash" in d.change for d in match.differences), text


def test_a_drive_that_is_not_plugged_in_and_one_too_many() -> None:
    simulated = bench(cia402_robot())
    simulated.devices()["rr_controller"].power_off()
    bus = cia402_robot().buses[0]
    nodes = tuple(node for node in bus.nodes if node.name != "fr_controller")
    smaller = replace(cia402_robot(), buses=(replace(bus, nodes=nodes),))
    (match,) = matches_on(simulated, candidates(smaller))
    text = words(match)
    assert "rr_controller (id 4) does not answer; look at its plugs" in text
    assert "a device with id 2 that the robot file does not name" in text
    assert "serial 0x102" in text
    assert len(match.differences) == 2


def test_nothing_is_sent_where_a_request_could_be_a_command() -> None:
    """To a drive with CANSimple, the identifier of an SDO request is a velocity command."""
    robot = cia402_robot()
    bus = robot.buses[0]
    nodes = tuple(
        replace(node, id_space="cansimple") if node.name == "fl_controller" else node
        for node in bus.nodes
    )
    other = replace(robot, name="other", buses=(replace(bus, nodes=nodes),))
    files = candidates(robot, other)
    assert "other/robot.yaml (fl_controller" in only_listens(files)
    simulated = bench(robot)
    found = matches_on(simulated, files)
    assert simulated.interface.controller.sent == 0
    assert found[0].ok > 0


def test_no_request_has_the_identifier_of_a_command_of_another_file() -> None:
    robot = cia402_robot()
    bus = robot.buses[0]
    command = next(frame for frame in bus.frames if frame.producer == "master")
    moved = replace(command, cob_id=0x600 + 99, name="command_of_another_file")
    other = replace(robot, name="other", buses=(replace(bus, frames=(*bus.frames, moved)),))
    simulated = bench(robot)
    sent: list[int] = []
    simulated.wire.observers.append(lambda time, frame, senders: sent.append(frame.id))
    matches_on(simulated, candidates(robot, other))
    assert 0x600 + 98 in sent
    assert 0x600 + 99 not in sent


def test_each_example_is_found_among_all_examples() -> None:
    paths = sorted(ROOT.glob("examples/*/robot.yaml"))
    robots = [example_robot(path.parent.name) for path in paths if path.parent.name not in PACKAGES]
    files = candidates(*(robot for robot in robots if robot.buses))
    for robot in robots:
        found = matches_on(bench(robot), files)
        best = [match for match in found if match.rank == found[0].rank]
        assert robot in [match.candidate.robot for match in best]
        assert found[0].differences == ()


def test_the_table_fits_a_terminal() -> None:
    found = matches_on(bench(cia402_robot()), candidates(cia402_robot(), other_robot(5)))
    lines = match_table(found, 80).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[1].split()[:2] == ["with_cia402/robot.yaml", "with_cia402"]
    assert found[0].as_json()["serials"] == 4
