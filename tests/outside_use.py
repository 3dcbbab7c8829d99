"""Which tests use outside programs and libraries, and which were skipped without them.

With ``OUTSIDE=record``, the tests that used one are added to the file ``RECORD``, a line for each
test function.  ``make test-bare`` runs them with ``OUTSIDE=none``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from tests import outside_tools

TESTS = Path(__file__).parent
RECORD = TESTS.parent / "build" / "outside-tests.txt"
DRAWING = ("--video", "render", "report", "GLContext")
"""Words in the arguments of a process that draws pictures."""
PROPERTY = ("outside", True)

_fixtures: set[str] = set()
"""Fixtures of more than one test that use a tool."""
_tests: set[str] = set()


def _check_process(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "subprocess.Popen":
        return
    caller = sys._getframe(1)
    while caller.f_back is not None and caller.f_code.co_filename == subprocess.__file__:
        caller = caller.f_back
    words = [os.fsdecode(str(word)) for word in (arguments[0], *arguments[1])]
    outside_tools.used.update(word for word in DRAWING if any(word in text for text in words[1:]))
    if Path(caller.f_code.co_filename).is_relative_to(TESTS):  # not a library
        if name := outside_tools.listed_name(words[0]):
            outside_tools.require(name)
    else:
        names = {tool.name for tool in outside_tools.TOOLS}
        outside_tools.used.update(names & {os.path.basename(words[0])})


sys.addaudithook(_check_process)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Generator[None, object, object]:
    outside_tools.used.clear()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any]) -> Generator[None, object, object]:
    before = set(outside_tools.used)
    outside_tools.used.clear()
    try:
        return (yield)
    finally:
        if outside_tools.used and fixturedef.scope != "function":
            _fixtures.add(fixturedef.argname)
        outside_tools.used.update(before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    fixtures = _fixtures & {*getattr(item, "fixturenames", ())}
    if report.when == "teardown" and (outside_tools.used or fixtures):
        report.user_properties.append(PROPERTY)
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if PROPERTY in map(tuple, report.user_properties):
        function = report.nodeid.partition("[")[0].partition("@")[0]  # @: the group of pytest-xdist
        _tests.add(function)


def pytest_sessionfinish() -> None:
    if os.environ.get("OUTSIDE") == "record" and "PYTEST_XDIST_WORKER" not in os.environ:
        RECORD.parent.mkdir(exist_ok=True)
        before = RECORD.read_text(encoding="utf-8").splitlines() if RECORD.exists() else []
        lines = sorted({*before, *_tests})
        RECORD.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def write_skips(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints the reasons of skipped tests, each with the number of tests."""
    reports = terminalreporter.stats.get("skipped", [])
    reasons = Counter(
        report.longrepr[2].removeprefix("Skipped: ")
        for report in reports
        if isinstance(report.longrepr, tuple)
    )
    if reasons:
        terminalreporter.section("skipped tests")
        for reason, number in reasons.most_common():
            terminalreporter.write_line(f"{number:6} {reason}")
