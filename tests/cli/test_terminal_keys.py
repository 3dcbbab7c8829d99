"""The terminal is restored and never delays the control cycle."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import termios
from collections.abc import Iterator
from typing import IO, Any, NamedTuple

import pytest

from thorvaldc.cli.terminal import Terminal


class Pty(NamedTuple):
    """``our_end`` is the end of the person."""

    our_end: int
    keys: IO[str]
    screen: IO[str]

    def output(self) -> str:
        """Returns the output that the command has written so far."""
        output = b""
        while select.select([self.our_end], [], [], 0.05)[0]:
            output += os.read(self.our_end, 65536)
        return output.decode()

    @property
    def settings(self) -> list[Any]:
        return termios.tcgetattr(self.keys.fileno())


@pytest.fixture
def terminal() -> Iterator[Pty]:
    our_end, terminal_end = pty.openpty()
    keys = os.fdopen(terminal_end, "r", closefd=False)
    screen = os.fdopen(os.dup(terminal_end), "w")
    yield Pty(our_end, keys, screen)
    for close in (keys.close, screen.close, lambda: os.close(terminal_end)):
        with contextlib.suppress(OSError):
            close()
    os.close(our_end)


def test_keys_come_one_by_one_and_are_not_shown(terminal: Pty) -> None:
    with Terminal(terminal.keys, terminal.screen) as raw:
        terminal.output()
        assert raw.read() == []
        os.write(terminal.our_end, b"i\x1b[A")
        assert raw.read() == ["i", "up"]
        os.write(terminal.our_end, b"\x1a\x1c\x13q")  # Ctrl-Z, Ctrl-\, Ctrl-S are plain keys
        assert raw.read()[-1] == "q"
        assert terminal.output() == ""


@pytest.mark.parametrize("fault", [None, KeyboardInterrupt, RuntimeError])
def test_the_settings_are_restored_after_any_exception(
    terminal: Pty, fault: type[BaseException] | None
) -> None:
    settings_before = terminal.settings
    with contextlib.ExitStack() as stack:
        if fault is not None:
            stack.enter_context(pytest.raises(fault))
        with Terminal(terminal.keys, terminal.screen) as raw:
            raw.show(["one", "two"])
            assert terminal.settings != settings_before
            if fault is not None:
                raise fault
    assert terminal.settings == settings_before
    output = terminal.output()
    assert output.startswith("\x1b[?25l")
    assert output.endswith("\x1b[?25h\r\n")


def test_lines_are_shown_over_the_last_and_cut_to_the_width(terminal: Pty) -> None:
    with Terminal(terminal.keys, terminal.screen) as raw:
        raw.show(["a", "b" * 500])
        raw.show(["c", "d"])
    output = terminal.output()
    assert "b" * 79 in output
    assert "b" * 80 not in output
    assert "\x1b[1A\r\x1b[2Kc\r\n\r\x1b[2Kd" in output


def test_a_stalled_terminal_does_not_delay_the_cycle(terminal: Pty) -> None:
    """As on a stalled connection, nobody reads the other end."""
    with Terminal(terminal.keys, terminal.screen) as raw:
        for _ in range(1000):
            raw.show(["x" * 70, "y" * 70])
        assert len(terminal.output()) < 100_000  # somebody reads again
        raw.show(["z"])
    assert "z" in terminal.output()


def test_a_terminal_that_hangs_up(terminal: Pty) -> None:
    with Terminal(terminal.keys, terminal.screen) as raw:
        os.close(os.dup(terminal.our_end))
        os.dup2(os.open(os.devnull, os.O_RDONLY), terminal.our_end)
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
