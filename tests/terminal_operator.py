"""A terminal at which a test answers the questions of a command."""

from __future__ import annotations

import os
import pty
import select
import termios
import time
from collections.abc import Mapping
from pathlib import Path

from tests.child_process import ChildProcess


def answer_questions(
    command: list[str],
    answers: Mapping[str, str],
    folder: Path,
    environment: Mapping[str, str],
    *,
    seconds: float = 120.0,
) -> tuple[int, str]:
    """Runs a command, and answers each text of ``answers`` when the terminal shows it.

    Ctrl-C is the answer ``"\\x03"``.  Returns the exit status and the text of the terminal.
    """
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    process = ChildProcess(
        command, cwd=folder, env=dict(environment), stdin=theirs, stdout=theirs, stderr=theirs,
        preexec_fn=lambda: os.login_tty(theirs), start_new_session=False,
    )  # fmt: skip
    os.close(theirs)
    shown, answered, until = "", 0, time.monotonic() + seconds
    try:
        while time.monotonic() < until:
            if select.select([ours], [], [], 0.2)[0]:
                try:
                    shown += os.read(ours, 65536).decode("utf-8", "replace")
                except OSError:  # the program has ended
                    break
            elif process.poll() is not None:
                break
            for question, line in answers.items():
                at = shown.find(question, answered)
                if at >= 0 and shown.find(") ", at) >= 0:
                    answered = shown.find(") ", at) + 2
                    os.write(ours, line.encode() if line == "\x03" else f"{line}\n".encode())
                    break
        assert process.poll() is not None or time.monotonic() < until, shown
        return process.wait(timeout=300), shown
    finally:
        process.end()
        os.close(ours)
