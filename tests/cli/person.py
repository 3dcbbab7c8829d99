"""Somebody at a terminal: a command on a pty, keys for it, what it shows."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import subprocess
import sys
import termios
import time
from pathlib import Path

PATIENCE = 20.0


class Person:
    """A command with a person at its terminal."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.ours, self.theirs = pty.openpty()
        self.before = termios.tcgetattr(self.theirs)
        self.shown = ""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "thorvaldc", *arguments],
            cwd=folder,
            stdin=self.theirs,
            stdout=self.theirs,
            stderr=self.theirs,
            start_new_session=True,
            # As a shell does: Ctrl-C and a hang-up reach the process by its terminal.
            preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TERM": "xterm"},
        )

    def read(self, seconds: float = 0.05) -> None:
        while select.select([self.ours], [], [], seconds)[0]:
            try:
                data = os.read(self.ours, 65536)
            except OSError:
                return
            if not data:
                return
            self.shown += data.decode("utf-8", "replace")

    def until(self, text: str, typing: str = "") -> None:
        """Wait until it is shown after what was waited for before, ``typing`` all the while."""
        limit = time.monotonic() + PATIENCE
        while text not in self.shown:
            assert time.monotonic() < limit, self.shown[-800:]
            assert self.process.poll() is None, self.shown[-800:]
            self.type(typing)
            self.read()
        self.shown = self.shown.partition(text)[2]

    def type(self, text: str) -> None:
        os.write(self.ours, text.encode())

    def end(self) -> int:
        """Its status; the terminal is as it was."""
        limit = time.monotonic() + PATIENCE
        while self.process.poll() is None:
            assert time.monotonic() < limit, "it does not end"
            self.read()
        self.read()
        assert termios.tcgetattr(self.theirs) == self.before
        assert "\x1b[?25h" in self.shown
        return self.process.returncode

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        for fd in (self.ours, self.theirs):
            with contextlib.suppress(OSError):
                os.close(fd)
