"""The terminal is put back as it was, and never holds the control cycle."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import termios
from collections.abc import Iterator
from typing import IO, Any, NamedTuple

import pytest

from thorvaldc.tools.teleoperation.terminal import Terminal


class Pty(NamedTuple):
    """``ours`` is the person's end."""

    ours: int
    keys: IO[str]
    screen: IO[str]

    def shown(self) -> str:
        """All that is to be read just now."""
        found = b""
        while select.select([self.ours], [], [], 0.05)[0]:
            found += os.read(self.ours, 65536)
        return found.decode()

    @property
    def settings(self) -> list[Any]:
        return termios.tcgetattr(self.keys.fileno())


@pytest.fixture
def terminal() -> Iterator[Pty]:
    ours, theirs = pty.openpty()
    keys = os.fdopen(theirs, "r", closefd=False)
    screen = os.fdopen(os.dup(theirs), "w")
    yield Pty(ours, keys, screen)
    for close in (keys.close, screen.close, lambda: os.close(theirs)):
        with contextlib.suppress(OSError):
            close()
    os.close(ours)


def test_keys_come_one_by_one_and_are_not_shown(terminal: Pty) -> None:
    with Terminal(terminal.keys, terminal.screen) as raw:
        terminal.shown()
        assert raw.read() == []
        os.write(terminal.ours, b"i\x1b[A")
        assert raw.read() == ["i", "up"]
        os.write(terminal.ours, b"\x1a\x1c\x13q")  # Ctrl-Z, Ctrl-\, Ctrl-S are plain keys
        assert raw.read()[-1] == "q"
        assert terminal.shown() == ""


@pytest.mark.parametrize("fault", [None, KeyboardInterrupt, RuntimeError])
def test_it_is_put_back_whatever_happened(terminal: Pty, fault: type[BaseException] | None) -> None:
    before = terminal.settings
    with contextlib.ExitStack() as stack:
        if fault is not None:
            stack.enter_context(pytest.raises(fault))
        with Terminal(terminal.keys, terminal.screen) as raw:
            raw.show(["one", "two"])
            assert terminal.settings != before
            if fault is not None:
                raise fault
    assert terminal.settings == before
    shown = terminal.shown()
    assert shown.startswith("\x1b[?25l")
    assert shown.endswith("\x1b[?25h\r\n")


def test_lines_are_shown_over_the_last_and_cut_to_the_width(terminal: Pty) -> None:
    with Terminal(terminal.keys, terminal.screen) as raw:
        raw.show(["a", "b" * 500])
        raw.show(["c", "d"])
    shown = terminal.shown()
    assert "b" * 79 in shown
    assert "b" * 80 not in shown
    assert "\x1b[1A\r\x1b[2Kc\r\n\r\x1b[2Kd" in shown


def test_a_terminal_that_takes_nothing_does_not_hold_the_robot(terminal: Pty) -> None:
    """As behind a connection that stalls: nobody reads the other end."""
    with Terminal(terminal.keys, terminal.screen) as raw:
        for _ in range(1000):
            raw.show(["x" * 70, "y" * 70])
        assert len(terminal.shown()) < 100_000  # somebody reads again
        raw.show(["z"])
    assert "z" in terminal.shown()


def test_a_terminal_that_hangs_up(terminal: Pty) -> None:
    with Terminal(terminal.keys, terminal.screen) as raw:
        os.close(os.dup(terminal.ours))
        os.dup2(os.open(os.devnull, os.O_RDONLY), terminal.ours)
        with pytest.raises(EOFError):
            raw.read()
        with pytest.raises(EOFError):
            raw.read()


def test_without_a_terminal_nothing_is_changed() -> None:
    with open(os.devnull) as keys, open(os.devnull, "w") as screen:
        with Terminal(keys, screen) as raw:
            raw.show(["x"])
        with Terminal(None, screen) as raw:
            assert raw.read() == []
