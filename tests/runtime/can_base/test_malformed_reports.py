"""Reports that are too short: their values are unknown, so that they count as missing."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import ROBOTS
from tests.slow import mostly_exhaustive
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.runtime.can_base.base_state_machine import BaseState

both = pytest.mark.parametrize("make", mostly_exhaustive(ROBOTS.values()), ids=ROBOTS)
REPORT = 0x181
"""COB-ID of the first report of ``fl_controller``."""


def shorten_reports(rig: Rig, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Lets ``fl_controller`` send ``count`` reports with one byte."""
    controller = rig.simulated.devices["fl_controller"].controller
    send = controller.send
    left = count

    def send_short(frame: CanFrame) -> bool:
        nonlocal left
        if frame.id == REPORT and left > 0:
            left -= 1
            frame = CanFrame(frame.id, frame.data[:1])
        return send(frame)

    monkeypatch.setattr(controller, "send", send_short)


@both
def test_malformed_reports_stop_the_robot(
    make: Callable[[], Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(make())
    rig.drive()
    shorten_reports(rig, monkeypatch, 1000)
    assert rig.until(lambda: rig.state is BaseState.FAULT, 1.0) < 0.1
    assert rig.reason.startswith("fl_controller: no valid tpdo1 for ")


@both
def test_one_malformed_report_is_tolerated(
    make: Callable[[], Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(make())
    rig.drive()
    shorten_reports(rig, monkeypatch, 1)
    rig.run(0.5)
    assert rig.state is BaseState.ACTIVE
    assert rig.base.connections[0].malformed == 1
