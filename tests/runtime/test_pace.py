"""Which signals end a run, and that further signals change nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from thorvaldc.runtime.pace import END_SIGNALS, end_signals

PROGRAM = """
import os, signal
from thorvaldc.runtime.pace import end_signals
with end_signals() as ended:
    os.kill(os.getpid(), signal.SIGHUP)
    print(ended())
    os.kill(os.getpid(), signal.SIGTERM)
    print(ended())
"""


@pytest.mark.parametrize("number", END_SIGNALS, ids=lambda number: number.name)
def test_the_first_signal_ends_the_run_and_others_change_nothing(number: signal.Signals) -> None:
    under_nohup = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    before = [signal.getsignal(each) for each in END_SIGNALS]
    with end_signals() as ended:
        assert not ended()
        os.kill(os.getpid(), number)
        assert ended()
        for other in END_SIGNALS:
            os.kill(os.getpid(), other)
        assert ended()
    assert [signal.getsignal(each) for each in END_SIGNALS] == before
    signal.signal(signal.SIGHUP, under_nohup)


def test_the_signals_are_those_of_persons_terminals_and_the_system() -> None:
    assert [number.name for number in END_SIGNALS] == ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"]


def test_a_program_under_nohup_outlives_its_terminal() -> None:
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.split() == ["False", "True"]


def test_outside_the_main_thread_no_signal_is_received() -> None:
    before = signal.getsignal(signal.SIGTERM)
    seen: list[bool] = []

    def work() -> None:
        with end_signals() as ended:
            seen.extend([signal.getsignal(signal.SIGTERM) == before, ended()])

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [True, False]
