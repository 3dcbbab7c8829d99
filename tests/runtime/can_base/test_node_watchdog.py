"""Heartbeats, boot-ups and reports of a node at times that the tests choose."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.simulation.bus.robots import cia402
from thorvaldc.can.canopen import NmtState
from thorvaldc.runtime.can_base.frame_receiver import LatestFrame
from thorvaldc.runtime.can_base.node_watchdog import NodeWatchdog

HEARTBEAT, REPORT = 0x701, 0x181
NAME = "fl_controller"
OPERATIONAL, PREOP, BOOT = b"\x05", b"\x7f", b"\x00"
PERIOD = 0.02


class Controller:
    """What the watchdog uses of a motor controller."""

    problem = ""

    def __init__(self, timeout: float | None = None) -> None:
        node = next(n for n in cia402().buses[0].nodes if n.name == NAME)
        self.node = replace(node, heartbeat_timeout=timeout)
        self.restarts = 0

    def handle_restart(self) -> None:
        self.restarts += 1

    def encoder_jump(self, now: float) -> str:
        return ""


class Setup:
    """A watchdog of one node, which sends heartbeats every 0.1 s and reports every 20 ms."""

    def __init__(self, timeout: float | None = None, *, heartbeat: bool = True) -> None:
        bus = cia402().buses[0]
        frames = tuple(
            replace(f, period=0.1) if f.cob_id == HEARTBEAT else f
            for f in bus.frames
            if f.cob_id == REPORT or (f.cob_id == HEARTBEAT and heartbeat)
        )
        self.controller: Any = Controller(timeout)
        self.latest: dict[int, LatestFrame] = {}
        bus = replace(bus, frames=frames, sync_period=PERIOD)
        self.watchdog = NodeWatchdog(bus, [self.controller], self.latest)

    def beat(self, time: float, data: bytes = OPERATIONAL) -> None:
        self.watchdog.take_heartbeat(HEARTBEAT, data, time)

    def report(self, time: float) -> None:
        self.latest[REPORT] = LatestFrame(time, b"", 1)

    def problem_at(self, now: float) -> str:
        """Runs two punctual cycles, the second at ``now``."""
        self.watchdog.begin_cycle(now - PERIOD, now - PERIOD, now - PERIOD)
        self.watchdog.begin_cycle(now, now, now)
        return self.problem(now)

    def problem(self, now: float) -> str:
        problem = self.watchdog.problem(self.controller, now)
        return "" if problem is None else problem.reason


@pytest.mark.parametrize(("timeout", "limit"), [(None, 0.3), (0.5, 0.3), (0.15, 0.15)])
def test_a_missing_heartbeat(timeout: float | None, limit: float) -> None:
    setup = Setup(timeout)
    setup.beat(5.0)
    setup.report(99.0)
    assert setup.problem_at(50.0) == "", "not started"
    setup.watchdog.start(1.0)
    assert setup.problem_at(5.0 + limit - 0.001) == ""
    text = f"no heartbeat for {1000 * limit + 1:.0f} ms"
    assert setup.problem_at(5.0 + limit + 0.001) == text
    setup.watchdog.stop()
    assert setup.problem_at(50.0) == ""
    setup.watchdog.start(49.0)  # the time before the start does not count
    assert setup.problem_at(49.0 + limit - 0.001) == ""
    assert setup.problem_at(49.0 + limit + 0.001) == text


def test_a_node_that_never_sends_a_heartbeat() -> None:
    setup = Setup()
    setup.report(99.0)
    setup.watchdog.start(1.0)
    assert setup.problem_at(1.29) == ""
    assert setup.problem_at(1.31) == "no heartbeat for 310 ms"


def test_a_node_without_heartbeat_is_watched_by_its_reports() -> None:
    setup = Setup(heartbeat=False)
    setup.watchdog.start(1.0)
    setup.report(1.0)
    assert setup.problem_at(1.04) == ""
    assert setup.problem_at(1.06) == "no tpdo1 for 60 ms"
    assert not setup.watchdog.is_silent(setup.controller)
    assert setup.watchdog.is_in_state(setup.controller, NmtState.OPERATIONAL, 1.0)


def test_a_missing_or_malformed_report() -> None:
    setup = Setup()
    setup.watchdog.start(1.0)
    setup.beat(2.0)
    setup.report(2.0)
    assert setup.problem_at(2.049) == ""
    assert setup.problem_at(2.051) == "no tpdo1 for 51 ms"
    setup.report(2.05)
    assert setup.problem_at(2.09) == ""
    setup.watchdog.malformed_since[REPORT] = 2.02
    assert setup.problem_at(2.069) == ""
    assert setup.problem_at(2.071) == "no valid tpdo1 for 51 ms"
    assert not setup.watchdog.has_all_reports(setup.controller)
    del setup.watchdog.malformed_since[REPORT]
    assert setup.watchdog.has_all_reports(setup.controller)
    setup.latest.clear()
    assert not setup.watchdog.has_all_reports(setup.controller)
    assert setup.problem_at(2.1) == "no tpdo1 for 1100 ms"


def test_a_node_that_is_not_operational() -> None:
    setup = Setup()
    setup.report(99.0)
    setup.beat(1.0, PREOP)
    setup.watchdog.start(1.0)
    assert setup.problem_at(1.02) == "", "this heartbeat is older"
    setup.beat(1.1, PREOP)
    assert setup.problem_at(1.12) == "its NMT state is pre-operational, not operational"
    assert setup.watchdog.is_in_state(setup.controller, NmtState.PRE_OPERATIONAL, 1.09)
    assert not setup.watchdog.is_in_state(setup.controller, NmtState.PRE_OPERATIONAL, 1.1)
    assert not setup.watchdog.is_in_state(setup.controller, NmtState.OPERATIONAL, 1.0)


def test_late_cycles_do_not_judge_silence_twice_in_a_row() -> None:
    setup = Setup()
    setup.watchdog.start(1.0)
    setup.beat(2.0)
    setup.report(2.0)

    def cycle(now: float) -> str:
        setup.watchdog.begin_cycle(now, now, now)
        return setup.problem(now)

    assert cycle(2.02) == ""
    assert [cycle(2.02 + k) for k in (1, 2)] == ["", ""]
    assert cycle(5.02) == "no heartbeat for 3020 ms"
    assert cycle(5.04) == "no heartbeat for 3040 ms", "a punctual cycle"
    assert cycle(5.04 + 0.031) == "", "1.5 periods: late"
    assert cycle(5.071 + 0.029) == "no heartbeat for 3100 ms", "less: punctual"


@pytest.mark.parametrize(
    ("received_until", "drained_until", "judged_at"),
    [
        (9.0, 9.0, 3.0),  # not later than now
        (2.99, 9.0, 2.99),
        (3.0, 2.97, 2.97),
        # The frames that had arrived one cycle before the last one have been read since.
        (3.0, 1.0, 2.96),
    ],
)
def test_silence_is_judged_at_the_time_up_to_which_frames_were_read(
    received_until: float, drained_until: float, judged_at: float
) -> None:
    setup = Setup()
    setup.report(99.0)
    setup.watchdog.start(1.0)
    setup.beat(2.0)
    setup.watchdog.begin_cycle(2.98, 2.98, 2.98)
    setup.watchdog.begin_cycle(3.0, received_until, drained_until)
    expected = f"no heartbeat for {1000 * (judged_at - 2.0):.0f} ms"
    assert setup.problem(3.0) == expected


def test_a_restart_during_the_drive_is_a_problem() -> None:
    setup = Setup()
    setup.beat(0.5, BOOT)
    setup.watchdog.start(1.0)
    setup.beat(1.1)
    setup.report(99.0)
    assert setup.problem_at(1.2) == ""
    setup.beat(1.2, BOOT)
    assert setup.controller.restarts > 1
    setup.beat(1.25)
    assert setup.problem_at(1.3) == "it restarted"
    setup.watchdog.start(1.3)
    assert setup.problem_at(1.32) == ""


@pytest.mark.parametrize(
    ("started", "gap", "state", "restarts"),
    [
        (True, 0.1, OPERATIONAL, 0),
        (True, 0.299, OPERATIONAL, 0),
        (True, 0.301, OPERATIONAL, 1),
        (False, 0.301, OPERATIONAL, 1),
        (True, 0.1, PREOP, 1),
        (False, 0.1, PREOP, 0),
        (True, 0.1, b"", 0),
    ],
)
def test_a_restart_whose_boot_up_was_lost(
    started: bool, gap: float, state: bytes, restarts: int
) -> None:
    setup = Setup()
    if started:
        setup.watchdog.start(1.0)
    setup.beat(2.0)
    setup.beat(2.0 + gap, state)
    assert setup.controller.restarts == restarts


def test_boot_ups_are_counted_for_the_start_up() -> None:
    setup = Setup()
    watchdog, controller = setup.watchdog, setup.controller
    assert watchdog.is_silent(controller)
    assert not watchdog.has_boot_ups
    setup.beat(1.0, BOOT)
    assert not watchdog.is_silent(controller)
    assert watchdog.has_boot_ups
    assert setup.controller.restarts == 1
    setup.beat(1.04, BOOT)  # repeated by an error on the bus
    assert watchdog.boot_up_problem(controller) == ""
    setup.beat(1.1, BOOT)
    text = "it restarted during the start-up; is a second device with the id 1 on the bus?"
    assert watchdog.boot_up_problem(controller) == text
    watchdog.allow_boot_ups(2)
    assert not watchdog.has_boot_ups
    for k in (2, 3):
        setup.beat(1.0 * k, PREOP)
        setup.beat(1.0 * k + 0.01, BOOT)
        assert watchdog.boot_up_problem(controller) == ""
    setup.beat(4.0, BOOT)
    assert watchdog.boot_up_problem(controller) == text
