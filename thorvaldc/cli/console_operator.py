"""A person at the terminal who carries out manual steps of commissioning and answers questions."""

from __future__ import annotations

import sys

from thorvaldc.commissioning.planner import AttachStep


class ConsoleOperator:
    """Prints a manual step and waits until the person presses the Enter key."""

    def attach(self, step: AttachStep, words: str) -> bool:
        return self._confirm(f"{words} Press Enter when it is done, or type `skip`. ")

    def power_all(self, words: str) -> bool:
        return self._confirm(f"{words} Press Enter when it is done. ")

    def _confirm(self, request: str) -> bool:
        line = _read_answer(request)
        return bool(line) and line.strip().lower() not in ("skip", "s")


def agrees(question: str) -> bool:
    """Asks a yes-or-no question and returns true for yes.

    An empty answer to the question means no.
    """
    return _read_answer(f"{question} [y/N] ").strip().lower() in ("y", "yes")


def _read_answer(question: str) -> str:
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline()
