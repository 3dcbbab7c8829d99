"""A person at a terminal: a command on a pseudo-terminal, its keys and its output."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import struct
import sys
import termios
import time
from pathlib import Path

from tests.child_process import ChildProcess, end_at_hang_up

PATIENCE = 300.0
"""Seconds for an answer, which a busy computer needs as well."""


class Person:
    """A running command and the person at its terminal."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.our_end, self.command_end = pty.openpty()
        self.settings_before = termios.tcgetattr(self.command_end)
        self.shown = ""
        self.process = ChildProcess(
            [sys.executable, "-m", "thorvaldc", *arguments],
            cwd=folder,
            stdin=self.command_end,
            stdout=self.command_end,
            stderr=self.command_end,
            start_new_session=True,
            preexec_fn=self._take_terminal,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm"},
        )

    def _take_terminal(self) -> None:
        """As in a shell, Ctrl-C and a hang-up reach the process through its terminal."""
        os.close(os.open(os.ttyname(0), os.O_RDWR))
        end_at_hang_up()

    def read(self, seconds: float = 0.05) -> None:
        while select.select([self.our_end], [], [], seconds)[0]:
            try:
                data = os.read(self.our_end, 65536)
            except OSError:
                return
            if not data:
                return
            self.shown += data.decode("utf-8", "replace")

    def until(self, text: str, typing: str = "") -> None:
        """Waits until the output contains ``text``; keeps typing ``typing``."""
        limit = time.monotonic() + PATIENCE
        while text not in self.shown:
            assert time.monotonic() < limit, self.shown[-800:]
            assert self.process.poll() is None, self.shown[-800:]
            self.type(typing)
            self.read()
        self.shown = self.shown.partition(text)[2]

    def resize(self, columns: int, lines: int) -> None:
        """Changes the size of the terminal, of which the command is told by SIGWINCH."""
        size = struct.pack("HHHH", lines, columns, 0, 0)
        fcntl.ioctl(self.our_end, termios.TIOCSWINSZ, size)

    def type(self, text: str) -> None:
        os.write(self.our_end, text.encode())

    def end(self) -> int:
        """Waits for the end; returns the status.  Checks that the terminal is restored."""
        limit = time.monotonic() + PATIENCE
        while self.process.poll() is None:
            assert time.monotonic() < limit, "it does not end"
            self.read()
        self.read()
        assert termios.tcgetattr(self.command_end) == self.settings_before
        assert "\x1b[?25h" in self.shown
        return self.process.returncode

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        for fd in (self.our_end, self.command_end):
            with contextlib.suppress(OSError):
                os.close(fd)
