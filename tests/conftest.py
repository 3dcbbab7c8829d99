"""Settings and fixtures of all tests."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import tests.examples  # noqa: F401  # chooses the robots before the worker processes start
from tests.child_process import ended_processes
from tests.outside_tools import HIDDEN, hide
from tests.outside_use import (  # noqa: F401
    pytest_fixture_setup,
    pytest_runtest_logreport,
    pytest_runtest_makereport,
    pytest_runtest_protocol,
    pytest_sessionfinish,
    write_skips,
)
from tests.workshop import Workshop

collect_ignore_glob = ["golden/*/*"]
"""Generated packages have tests of their own."""

if HIDDEN:
    hide()

# Hypothesis draws the same examples on every machine: a test fails only because of a change.
# HYPOTHESIS_PROFILE=default draws new ones.  There is no deadline: machines may be slow.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


# The time limit of each test in s, for pytest-timeout.  A test needs seconds, on a slow shared
# machine a minute; one that takes this long hangs.  The signal ends it where it waits, so that its
# fixtures end its processes and the other tests run.
os.environ.setdefault("PYTEST_TIMEOUT", "600")


# A shell starts a background job with SIGINT ignored, and child processes inherit that.
# The programs under test could then not be interrupted.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Half a million objects describe the tests, and stay to the end.  A garbage collection that looks
# at them takes 0.5 s; all collections took a tenth of the processor time of the tests.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.set_threshold(10_000)
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    write_skips(terminalreporter)
    terminalreporter.write_line(
        f"robots of the tests for every robot: ROBOTS={os.environ['ROBOTS']}"
    )


@pytest.fixture(autouse=True)
def _no_process_outlives_its_test() -> Iterator[None]:
    with ended_processes():
        yield


@pytest.fixture(autouse=True)
def _interrupts_reach_the_next_test() -> Iterator[None]:
    # An interrupted command ignores SIGINT while its process ends.  Where a test runs the command
    # in its own process, programs that later tests start would inherit that.
    handler = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, handler)


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    """Returns a folder for test robots."""
    return Workshop(tmp_path)
