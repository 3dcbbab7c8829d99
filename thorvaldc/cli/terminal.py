"""A terminal that reads keys without waiting and always restores its settings."""

from __future__ import annotations

import contextlib
import os
import re
import select
import shutil
from typing import IO, Any

# Escape sequences of the arrow keys in the normal mode and in the application mode of a terminal.
_SEQUENCES = {
    "[A": "up", "[B": "down", "[C": "right", "[D": "left",
    "OA": "up", "OB": "down", "OC": "right", "OD": "left",
    "[1;2A": "shift-up", "[1;2B": "shift-down", "[1;2C": "shift-right", "[1;2D": "shift-left",
}  # fmt: skip
_SEQUENCE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z~]|O[A-Za-z]|[^\x1b]|$)")
_CONTROL = {"\x03": "ctrl-c", "\x04": "ctrl-d"}


def keys_of(text: str) -> list[str]:
    """Returns the names of the keys in the input of a terminal.

    Unknown escape sequences of the terminal are ignored.
    """
    keys = []
    at = 0
    while at < len(text):
        if text[at] == "\x1b":
            match = _SEQUENCE.match(text, at)
            name = _SEQUENCES.get(match[1]) if match else None
            if name is not None:
                keys.append(name)
            at = match.end() if match else at + 1
            continue
        keys.append(_CONTROL.get(text[at], text[at]))
        at += 1
    return keys


class Terminal:
    """A terminal that reads keys from ``keys`` and shows lines at the bottom of ``screen``.

    Inside the ``with`` block, the terminal does not echo keys and reports each key without Enter.
    The keys Ctrl-Z, Ctrl-\\ and Ctrl-S do not stop the process, so the control cycle continues. The
    key Ctrl-C still interrupts the process. At the end of the ``with`` block, the terminal settings
    are restored, even after an exception.
    """

    def __init__(self, keys: IO[str] | None, screen: IO[str], *, whole: bool = False) -> None:
        """Creates the terminal object without changing the settings of the terminal.

        If ``whole`` is true, the lines use the whole screen, and the previous content of the screen
        is restored at the end.
        """
        self._keys = keys
        self._screen = screen
        self._settings: list[Any] | None = None
        self._whole = whole
        self._shown_lines = 0
        self._is_terminal = screen.isatty()
        self._out = -1
        self._pending = b""

    def __enter__(self) -> Terminal:
        if self._keys is not None and self._keys.isatty():
            import termios

            fd = self._keys.fileno()
            self._settings = termios.tcgetattr(fd)
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
            # The terminal device is opened a second time for non-blocking output. Non-blocking mode
            # on the existing file would also affect other processes that use the same terminal.
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
                self._write("\x1b[?25h" + ("\n" if self._shown_lines else ""))
            if self._out >= 0:
                os.close(self._out)
                self._out = -1
        if self._settings is not None and self._keys is not None:
            import termios

            fd = self._keys.fileno()
            with contextlib.suppress(OSError, ValueError, termios.error):  # closed terminal
                termios.tcflush(fd, termios.TCIFLUSH)
                # The option TCSADRAIN would wait until all output is sent, which never ends on a
                # stalled terminal.
                termios.tcsetattr(fd, termios.TCSANOW, self._settings)
            self._settings = None

    def read(self) -> list[str]:
        """Returns the keys that were pressed since the last call, without waiting.

        Raises ``EOFError`` if the terminal is closed.
        """
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
        """Replaces the lines at the bottom of the screen by new lines.

        The new status lines are dropped if the terminal currently accepts no output. A stalled
        connection to the terminal must not delay the control cycle.
        """
        self._write("")
        if not self._is_terminal or self._pending:
            return
        width = max(shutil.get_terminal_size().columns - 1, 20)
        body = "\n".join(f"\r\x1b[2K{line[:width]}" for line in lines)
        if self._whole:
            self._write(f"\x1b[H{body}\x1b[J")
            return
        up = f"\x1b[{self._shown_lines - 1}A" if self._shown_lines > 1 else ""
        self._shown_lines = len(lines)
        # The lines may be fewer than before.
        self._write(f"{up}{body}\x1b[J")

    def _write(self, text: str) -> None:
        """Writes as much waiting text to the terminal as possible without blocking.

        The next call of the method writes the remaining text.
        """
        self._pending += text.encode("utf-8", "replace")
        if not self._pending or not self._is_terminal:
            return
        fd = self._out if self._out >= 0 else self._screen.fileno()
        with contextlib.suppress(OSError):
            written = os.write(fd, self._pending)
            self._pending = self._pending[written:]
