"""Settings and fixtures of all tests."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.workshop import Workshop

# Hypothesis draws the same examples on every machine: a test fails only because of a change.
# HYPOTHESIS_PROFILE=default draws new ones.  There is no deadline: machines may be slow.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


# A shell starts a background job with SIGINT ignored, and child processes inherit that.
# The programs under test could then not be interrupted.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    """Returns a folder for test robots."""
    return Workshop(tmp_path)
