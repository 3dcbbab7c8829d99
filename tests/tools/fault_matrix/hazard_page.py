"""The hazard log docs/hazards.md, from the fault tables of docs/faults.md and the rules of arming.

``python -m tests.tools.fault_matrix.hazard_page`` writes its tables.  It raises ``ValueError`` if a
test that holds a hazard is gone, or if a fault or a rule of the permission belongs to no hazard.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.runtime.test_exploration import RULES
from tests.tools.fault_matrix.fault_table_page import BEGIN, END, GROUND, PAGE, TOPICS, replaced
from thorvaldc.diagnostics.text_layout import markdown_table

ROOT = Path(__file__).parents[3]
HAZARDS_PAGE = PAGE.with_name("hazards.md")
FAULT_TABLE = "<!-- made by tests/tools/fault_matrix/hazard_page.py: faults -->\n"
RULE_TABLE = "<!-- made by tests/tools/fault_matrix/hazard_page.py: permission -->\n"
CAN, RUNTIME = "tests/runtime/can_base", "tests/runtime"
PROMISES = "tests/tools/fault_matrix/test_promises.py"
ROWS = f"{PROMISES}::test_every_promise_is_kept_and_is_on_the_page"
EXPLORED = f"{RUNTIME}/test_exploration.py::test_every_state_of_the_permission"
RULE_TAKEN_OUT = f"{RUNTIME}/test_exploration.py::test_each_rule_taken_out_is_found"


class Hazard(NamedTuple):
    """A hazard, and the tests that hold it.

    - ``members``: regular expressions of the names of faults, or the names of rules;
    - ``left``: what the software does not do.
    """

    name: str
    detection: str
    members: tuple[str, ...]
    tests: tuple[str, ...]
    left: str


FAULTS = (
    Hazard(
        "a drive fails, or leaves the bus",
        "reports, heartbeats, EMCY, SDO, boot-up messages",
        (
            "power of a drive cut",
            "a drive (sends|receives) nothing",
            "heartbeat of a drive stops",
            "EMCY message of a drive",
            "a drive uses another bitrate",
            "a drive is bus-off",
            "a drive ignores SYNC",
        ),
        (ROWS, f"{CAN}/test_bus_loop.py::test_a_missing_heartbeat_is_a_fault"),
        "a Thorvald script that receives nothing is noticed when it should drive",
    ),
    Hazard(
        "a wheel does not do what it is commanded to",
        "commanded against measured motion of each motor; then the ladder of stops",
        (
            "a drive ignores its commands",
            "reports of a drive freeze",
            "encoder of a (wheel|steering) (freezes|jumps.*)",
            "a wheel is blocked",
            "deceleration of a drive made tiny",
            "a steering hunts about a wrong angle",
        ),
        (ROWS, f"{CAN}/test_disobedient_drives.py::test_a_drive_that_ignores_nmt_too_is_starved"),
        "at rest, and while the target does not change, most of it shows nothing",
    ),
    Hazard(
        "a wheel turns by itself",
        "measured motion of a wheel that should stand; the wheel is named",
        ("a wheel (creeps at rest|runs away.*)", "a slope turns a wheel at rest"),
        (ROWS, f"{CAN}/test_disobedient_drives.py::test_a_runaway_at_full_speed_is_named"),
        "**a person cuts the power**: no software stops a motor with a shorted power stage",
    ),
    Hazard(
        "the settings or the watchdog of a drive are changed",
        "all required objects are read again and again",
        ("a drive forgets its watchdog", "a deceleration of .*", "two drives swap .*"),
        (ROWS, f"{CAN}/test_object_supervision.py::test_a_change_that_nothing_else_shows"),
        "a Thorvald script does not report that it has lost its watchdog: test it by hand",
    ),
    Hazard(
        "something else on the bus commands the drives, or imitates them",
        "each identifier of the master, rates of all frames, SDO responses, unknown nodes",
        (
            "another master .*",
            "(extended|remote) frames .*",
            "false reports .*",
            "a drive takes the id .*",
            "a second drive .*",
            "EMCY message of an unknown node",
        ),
        (ROWS, f"{CAN}/test_second_devices.py::test_every_identifier_of_the_master_from_elsewhere"),
        "frames that are equal to those of the driver and begin at the same bit",
    ),
    Hazard(
        "frames are lost, late or destroyed, or the bus is full",
        "missing reports, incomplete cycles, error counters",
        (
            "a drive (floods|fills half of) the bus .*",
            "one frame in ten is destroyed",
            "all frames arrive .*",
            "commands of a drive arrive .*",
            "two in five commands .*",
        ),
        (ROWS, f"{CAN}/test_bus_loop.py::test_one_missed_report_is_tolerated_two_are_a_fault"),
        "commands of one drive that are up to 0.2 s late; its wheel brakes later by this time",
    ),
    Hazard(
        "wrong speeds are reported",
        "changes of the reported speed of a wheel that no motion explains",
        ("three in ten speeds of a wheel are random",),
        (ROWS, f"{CAN}/test_disobedient_drives.py::test_random_speeds_of_a_wheel_stop_the_robot"),
        "one wrong report a second, and speeds that are wrong by less than a motor changes them in"
        " 0.1 s: the odometry of a robot with two drives is wrong",
    ),
    Hazard(
        "the power fails",
        "reports of the drives, and charge, voltage and silence of the batteries",
        ("power of all drives cut", "(all batteries|battery|one of several batteries) .*"),
        (ROWS, f"{CAN}/test_arming.py::test_a_battery_that_reports_no_voltage_refuses"),
        "without power only friction and brakes stop and hold the robot",
    ),
    Hazard(
        "the base driver hangs, is late, or dies",
        "gap between two cycles; the watchdogs of the drives",
        ("driver stalls .*", "driver process killed"),
        (
            ROWS,
            "tests/model/test_stopping.py::test_a_dead_driver",
            f"{CAN}/test_late_processes.py::test_a_late_process_of_the_bus_is_no_silent_node",
        ),
        "a clock that stands, if the frames of that time are lost, too",
    ),
    Hazard(
        "the program or the person that commands is gone",
        "age of the newest twist; end of the connection",
        ("client hangs", "connection of the client closed"),
        (
            ROWS,
            f"{RUNTIME}/test_run_session.py"
            "::test_the_twist_of_a_session_ends_as_soon_as_it_was_ineffective",
        ),
        "a person who does not look holds the stick",
    ),
)
TOPIC_HAZARDS = (
    Hazard(
        "the program behind the joint topics (Gazebo, ros2_control, Isaac Sim) is silent or lies",
        "stamps, values and changes of the joint states",
        (".*",),
        (
            f"{PROMISES}::test_joints_behind_topics_are_stopped_as_on_the_page",
            "tests/ros/test_topic_stops.py::test_frozen_joint_states_sustain_no_motion",
        ),
        "**a driver that is killed without its guard**: the other program keeps the last command",
    ),
)
GROUND_TEST = "tests/tools/fault_matrix/test_ground_faults.py"
GROUND_HAZARDS = (
    Hazard(
        "a wheel stalls, and the odometry takes its stillness for the robot's",
        "speeds of the wheels against each other, their commands and the yaw rate of an IMU",
        ("(a wheel|all wheels) stalls?",),
        (f"{GROUND_TEST}::test_stalled_wheels_are_warned_about_and_within_the_stated_error",),
        "which of the wheels is right, if half of them stall",
    ),
    Hazard(
        "wheels slide, or hang in the air: the robot does not move as they turn",
        "speeds of the wheels against each other, their commands and the yaw rate of an IMU",
        ("the robot is held", "(held, )?(a wheel|all wheels)( but one)? (on ice|in the air)"),
        (f"{GROUND_TEST}::test_a_held_robot_with_an_imu_is_warned_about",),
        "**wheels that all turn as commanded show nothing** until the robot should turn and its IMU"
        " says that it does not: look at sensors that do not use the wheels",
    ),
)
PERMISSION = (
    Hazard(
        "the robot starts, and nobody asks for it at that moment",
        "a source that was ineffective commands zero first",
        (
            "a new source commands zero",
            "an ineffective source commands zero",
            "a motion from before the arming is void",
            "nothing is armed that is moved",
            "the twists of a program end with it",
            "a gap voids the commands",
            "a zero before a gap is void",
        ),
        (
            EXPLORED,
            RULE_TAKEN_OUT,
            "tests/runtime/test_driver.py"
            "::test_joint_states_may_be_missing_as_long_as_a_cycle_may_be_late",
        ),
        "a source with `first_command: any` resumes; one with `ramp` begins with a small step",
    ),
    Hazard(
        "the robot accepts motion, and no person has checked that it may",
        "arming by a person, lost with every stop, fault and silence",
        (
            "a refused arming changes nothing",
            "a person disarms",
            "a person ends automatic arming",
            "a base that holds disarms",
            "a forgotten robot is disarmed",
        ),
        (EXPLORED, RULE_TAKEN_OUT),
        "`arming: automatic` arms a robot that passes all checks",
    ),
    Hazard(
        "a stop does not work, or ends too early",
        "each stop is held by name, and works in every state alone",
        (
            "a lock that is released soon counts",
            "locks are active",
            "a stop belongs to its programs",
            "each stop is released for itself",
            "whoever holds a stop is named",
            "a stop outlives its program",
        ),
        (EXPLORED, RULE_TAKEN_OUT),
        "`force` releases the stops of others, and says so",
    ),
    Hazard(
        "two programs drive at once",
        "a source is bound to its program until it is silent",
        ("a source belongs to one program",),
        (EXPLORED, RULE_TAKEN_OUT),
        "",
    ),
    Hazard(
        "steering turns while a person works on the robot",
        "homing is motion, and is refused under a stop",
        ("a stopped robot does not home",),
        (EXPLORED, RULE_TAKEN_OUT),
        "a person who has engaged no stop",
    ),
)
HEADINGS = ("hazard", "detection", "reaction while driving", "rest, of promised", "test", "left")
RULE_HEADINGS = ("hazard", "rules", "test", "left")


# -- the fault tables -----------------------------------------------------------------------------


class Row(NamedTuple):
    """A row of a fault table: the cells while driving (or the first one) and of the promise."""

    fault: str
    driving: str
    promised: str


def cells(begin: str) -> list[list[str]]:
    """Returns the cells of a table of docs/faults.md, with its headings."""
    table = PAGE.read_text(encoding="utf-8").partition(begin)[2].partition(END)[0]
    lines = [[c.strip() for c in line.split("|")[1:-1]] for line in table.splitlines()]
    return [lines[0], *lines[2:]]


def rows(begin: str) -> list[Row]:
    """Returns the rows of a table of docs/faults.md."""
    head, *lines = cells(begin)
    driving, promised = head.index("driving"), head.index("promised")
    return [Row(line[0], line[driving], line[promised]) for line in lines]


def owned(hazards: Iterable[Hazard], names: Iterable[str]) -> dict[Hazard, list[str]]:
    """Returns the names of each hazard.  Each name belongs to one hazard, and each expression to a
    name; else raises ``ValueError``."""
    members: dict[Hazard, list[str]] = {hazard: [] for hazard in hazards}
    used: set[str] = set()
    for name in dict.fromkeys(names):
        found = [
            (hazard, text)
            for hazard in members
            for text in hazard.members
            if re.fullmatch(text, name)
        ]
        if len(found) != 1:
            raise ValueError(f"`{name}` belongs to {len(found)} hazards")
        members[found[0][0]].append(name)
        used.add(found[0][1])
    unused = {text for hazard in members for text in hazard.members} - used
    if unused:
        raise ValueError(f"nothing is called {', '.join(sorted(unused))}")
    return members


def fault_lines(hazards: Sequence[Hazard], table: Sequence[Row]) -> Iterator[tuple[str, ...]]:
    for hazard, faults in owned(hazards, (row.fault for row in table)).items():
        mine = [row for row in table if row.fault in faults]
        yield (
            hazard.name,
            hazard.detection or "none",
            reactions(mine),
            rests(mine),
            test_links(hazard.tests),
            hazard.left,
        )


def reactions(table: Sequence[Row]) -> str:
    """Returns how often each reaction is in the table, the longest time first."""
    counts = Counter(row.driving.split(" in ")[0].split(";")[0] for row in table if row.driving)
    text = ", ".join(f"{name} ({number})" for name, number in counts.most_common())
    times = [float(m[1]) for row in table if (m := re.search(r" in ([0-9.]+) s;", row.driving))]
    return f"{text}, within {max(times):.1f} s" if times else text


def rests(table: Sequence[Row]) -> str:
    """Returns the longest time and path until rest while driving, and the longest promised ones."""
    pattern = r"([0-9.]+) s, ([0-9.]+) m$"
    measured = [m for row in table if (m := re.search(f"rest {pattern}", row.driving))]
    promised = [m for row in table if (m := re.search(pattern, row.promised))]
    errors = [m for row in table if (m := re.search(r"no stop, ([0-9.]+) m/s", row.driving))]
    parts = []
    if measured:
        time, path = (max(float(m[i]) for m in measured) for i in (1, 2))
        parts.append(f"{time:.1f} s, {path:.2f} m")
        if promised:
            time, path = (max(float(m[i]) for m in promised) for i in (1, 2))
            parts[0] += f" of {time:.1f} s, {path:.2f} m"
    if errors:
        parts.append(f"no stop: speed wrong by {max(float(m[1]) for m in errors):.2f} m/s")
    return "; ".join(parts)


def ground_lines() -> Iterator[tuple[str, ...]]:
    _, *table = cells(GROUND)
    for hazard, faults in owned(GROUND_HAZARDS, (row[1] for row in table)).items():
        mine = [row for row in table if row[1] in faults]
        errors = [[float(m) for m in re.findall(r"[0-9.]+", row[4])] for row in mine]
        error, stated = max(errors, key=lambda pair: pair[0] / max(pair[1], 0.01))
        warned = sum(row[5] != "none" for row in mine)
        reaction = f"warns ({warned}), continues ({len(mine) - warned})"
        rest = f"no stop: position wrong by {error:.2f} m, stated {stated:.2f} m"
        tests = test_links(hazard.tests)
        yield hazard.name, hazard.detection, reaction, rest, tests, hazard.left


# -- the permission -------------------------------------------------------------------------------


def rule_lines() -> Iterator[tuple[str, ...]]:
    for hazard, rules in owned(PERMISSION, RULES).items():
        text = f"{hazard.detection}: {'; '.join(rules)}"
        yield hazard.name, text, test_links(hazard.tests), hazard.left


# -- tests ----------------------------------------------------------------------------------------


def test_links(tests: Iterable[str]) -> str:
    """Returns the tests as text.  Raises ``ValueError`` if one is gone."""
    names = []
    for test in tests:
        path, _, name = test.partition("::")
        file = ROOT / path
        if not file.exists() or f"\ndef {name}(" not in file.read_text(encoding="utf-8"):
            raise ValueError(f"the test {test} is gone; what holds the hazard now?")
        names.append(f"`{Path(path).stem}::{name}`")
    return ", ".join(names)


def text() -> str:
    """Returns the page with new tables."""
    page = HAZARDS_PAGE.read_text(encoding="utf-8")
    lines = [*fault_lines(FAULTS, rows(BEGIN)), *fault_lines(TOPIC_HAZARDS, rows(TOPICS))]
    lines += ground_lines()
    page = replaced(page, FAULT_TABLE, markdown_table([HEADINGS, *lines]))
    return replaced(page, RULE_TABLE, markdown_table([RULE_HEADINGS, *rule_lines()]))


def main() -> int:
    HAZARDS_PAGE.write_text(text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
