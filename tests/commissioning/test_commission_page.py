"""The page of the report of the first motion: accessible, alone, and with what failed."""

from __future__ import annotations

from tests.accessibility import accessible_page
from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.commissioning.commission_page import page_of
from thorvaldc.commissioning.commission_report import (
    FAILED,
    CalibratedWheel,
    CalibrationResult,
    CheckedMotor,
    CommissionReport,
    Figure,
    Finding,
    FoundNode,
    LastingError,
)

ROBOT = make_robot(FOUR_STEERED)
MOTOR = ROBOT.actuators[0].name


def report(*findings: Finding, idle: str = "idle") -> CommissionReport:
    figures = (Figure("travel", 1.5, "rad", 0.9, 1.1), Figure("stop", 0.2, "s", 0.0, 0.4))
    motor = CheckedMotor(MOTOR, "node", "1", "key", FAILED, figures=figures, not_tested=("brake",))
    calibration = CalibrationResult(
        (CalibratedWheel("w0", 0.01, 0.001, None, None),), (LastingError("heading", 0.02),)
    )
    node = FoundNode("node", "ok", 3, 1, 2, 3)
    nodes, motors = (node,), (motor, CheckedMotor(idle, None, None, "key"))
    head = (ROBOT.name, "0123", "0.1.0", "2030-01-01", "A & B", "Ctrl-C")
    return CommissionReport(*head, nodes, findings, motors, calibration)


def test_the_page_is_accessible_and_has_the_results() -> None:
    finding = Finding((MOTOR,), f"{MOTOR} counts backwards", "state `inverted: true`")
    page = accessible_page(page_of(ROBOT, report(finding)))
    texts = [text for _, text in page.texts]
    for text in ("A & B", "Ctrl-C", "What to change", "inverted: true", "1.50 rad", "not tested"):
        assert text in texts
    assert ("h1", f"First motion of {ROBOT.name}: not passed") in page.texts
    assert ("h2", f"Motor {MOTOR}: failed") in page.texts
    assert ("h2", "Motor idle: not tested") in page.texts
    assert [a.get("class") for a in page.all("td")].count("fault") == 1
    assert "Errors that remain, in SI units: heading 0.02." in texts
    assert [a.get("fill") for a in page.all("rect")].count("#b00020") == 1


def test_the_names_of_a_report_are_texts() -> None:
    """A report is a file that others may have written."""
    name = '<b>"\' onfocus="alert(1)'
    page = accessible_page(page_of(ROBOT, report(idle=name)))
    assert ("h2", f"Motor {name}: not tested") in page.texts
    assert all("onfocus" not in attributes for attributes in page.all("section"))
    assert all("onfocus" not in attributes for attributes in page.all("table"))


def test_a_report_without_findings_says_nothing_of_changes() -> None:
    page = accessible_page(page_of(ROBOT, report()))
    assert "What to change" not in [text for _, text in page.texts]
    assert {a.get("fill") for a in page.all("rect")} == {"#333"}
