"""A terminal that gives keys as they are pressed, and is always put back as it was."""

from __future__ import annotations

import contextlib
import os
import re
import select
import shutil
from typing import IO, Any

# What terminals send for keys that are no characters, in both of their modes.
_SEQUENCES = {
    "[A": "up", "[B": "down", "[C": "right", "[D": "left",
    "OA": "up", "OB": "down", "OC": "right", "OD": "left",
    "[1;2A": "shift-up", "[1;2B": "shift-down", "[1;2C": "shift-right", "[1;2D": "shift-left",
}  # fmt: skip
_SEQUENCE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z~]|O[A-Za-z]|[^\x1b]|$)")
_CONTROL = {"\x03": "ctrl-c", "\x04": "ctrl-d"}


def keys_of(text: str) -> list[str]:
    """The keys behind what a terminal sent; sequences that are not known are left out."""
    keys = []
    at = 0
    while at < len(text):
        if text[at] == "\x1b":
            found = _SEQUENCE.match(text, at)
            name = _SEQUENCES.get(found[1]) if found else None
            if name is not None:
                keys.append(name)
            at = found.end() if found else at + 1
            continue
        keys.append(_CONTROL.get(text[at], text[at]))
        at += 1
    return keys


class Terminal:
    """Keys from ``keys``, and lines at the foot of what is shown on ``screen``.

    Within ``with``: no echo, no waiting for a line, and no way for Ctrl-Z, Ctrl-\\ or Ctrl-S
    to hold a robot's control cycle.  Ctrl-C interrupts as ever.  Leaving puts all of it
    back, whatever was the reason.
    """

    def __init__(self, keys: IO[str] | None, screen: IO[str], *, whole: bool = False) -> None:
        """``whole``: the lines have the screen for themselves; what was there comes back."""
        self._keys = keys
        self._screen = screen
        self._before: list[Any] | None = None
        self._whole = whole
        self._shown = 0
        self._is_terminal = screen.isatty()
        self._out = -1
        self._pending = b""

    def __enter__(self) -> Terminal:
        if self._keys is not None and self._keys.isatty():
            import termios

            fd = self._keys.fileno()
            self._before = termios.tcgetattr(fd)
            raw = termios.tcgetattr(fd)
            raw[0] &= ~(termios.IXON | termios.ICRNL)
            raw[3] &= ~(termios.ICANON | termios.ECHO | termios.IEXTEN)
            disabled = os.fpathconf(fd, "PC_VDISABLE")
            raw[6][termios.VMIN], raw[6][termios.VTIME] = 0, 0
            for name in ("VSUSP", "VQUIT", "VDSUSP"):
                if hasattr(termios, name):
                    raw[6][getattr(termios, name)] = bytes([disabled & 0xFF])
            termios.tcsetattr(fd, termios.TCSANOW, raw)
        if self._is_terminal:
            self._screen.flush()
            # Opened anew: not to wait is a property of what was opened, which others share.
            with contextlib.suppress(OSError):
                name = os.ttyname(self._screen.fileno())
                self._out = os.open(name, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
            self._write("\x1b[?1049h\x1b[?25l" if self._whole else "\x1b[?25l")
        return self

    def __exit__(self, *_: object) -> None:
        if self._is_terminal:
            if self._whole:
                self._write("\x1b[?25h\x1b[?1049l")
            else:
                self._write("\x1b[?25h" + ("\n" if self._shown else ""))
            if self._out >= 0:
                os.close(self._out)
                self._out = -1
        if self._before is not None and self._keys is not None:
            import termios

            fd = self._keys.fileno()
            with contextlib.suppress(OSError, ValueError, termios.error):  # hung up
                termios.tcflush(fd, termios.TCIFLUSH)
                # Not to wait until all is shown, which may be never.
                termios.tcsetattr(fd, termios.TCSANOW, self._before)
            self._before = None

    def read(self) -> list[str]:
        """The keys since the last call; never waits.  Raises ``EOFError`` where it is gone."""
        if self._keys is None:
            return []
        fd = self._keys.fileno()
        if not select.select([fd], [], [], 0.0)[0]:
            return []
        try:
            data = os.read(fd, 1024)
        except OSError:
            raise EOFError from None
        if not data:
            raise EOFError
        return keys_of(data.decode("utf-8", "replace"))

    def show(self, lines: list[str]) -> None:
        """Replace the lines at the foot; dropped where the terminal does not take them.

        A terminal behind a stalled connection must not hold the control cycle.
        """
        self._write("")
        if not self._is_terminal or self._pending:
            return
        width = max(shutil.get_terminal_size().columns - 1, 20)
        body = "\n".join(f"\r\x1b[2K{line[:width]}" for line in lines)
        if self._whole:
            self._write(f"\x1b[H{body}\x1b[J")
            return
        up = f"\x1b[{self._shown - 1}A" if self._shown > 1 else ""
        self._shown = len(lines)
        self._write(f"{up}{body}")

    def _write(self, text: str) -> None:
        """What the terminal does not take now goes out before what comes next."""
        self._pending += text.encode("utf-8", "replace")
        if not self._pending or not self._is_terminal:
            return
        fd = self._out if self._out >= 0 else self._screen.fileno()
        with contextlib.suppress(OSError):
            written = os.write(fd, self._pending)
            self._pending = self._pending[written:]
