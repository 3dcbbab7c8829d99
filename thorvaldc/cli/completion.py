"""Completion of commands, options and values in the shells bash, zsh and fish.

typer generates the shell scripts (``thorvaldc --install-completion``).  A script starts the program
with ``_THORVALDC_COMPLETE`` in its environment at each press of the Tab key, so the answer must
come at once: the file of a command imports only what its options need.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator, Sequence

COMPLETE_VARIABLE = "_THORVALDC_COMPLETE"


def is_completion() -> bool:
    """Returns whether a shell asks for the completion of a command line."""
    return os.environ.get(COMPLETE_VARIABLE, "").startswith("complete_")


@contextlib.contextmanager
def shell_completion() -> Iterator[None]:
    """Adapts the answer of typer to the shell that asks for a completion.

    bash splits words at ``=`` and ``:``, and replaces only the part after them.
    """
    # typer formats help texts with rich if rich is installed. Its import takes 100 ms.
    sys.modules.setdefault("rich", None)  # type: ignore[arg-type]
    prefix = ""
    if os.environ[COMPLETE_VARIABLE] == "complete_bash":
        words, number, prefix = joined_words(
            os.environ.get("COMP_WORDS", "").split(), int(os.environ.get("COMP_CWORD", "0"))
        )
        os.environ["COMP_WORDS"], os.environ["COMP_CWORD"] = "\n".join(words), str(number)
    answer = io.StringIO()
    try:
        with contextlib.redirect_stdout(answer):
            yield
    finally:
        for line in answer.getvalue().splitlines():
            print(line.removeprefix(prefix))


def joined_words(words: Sequence[str], number: int) -> tuple[list[str], int, str]:
    """Joins the words of a command line that bash has split at ``=`` and ``:``.

    Returns the words, the index of the incomplete word, and the part of the incomplete word that
    bash does not replace.  An option and its value, as in ``--bus=sim:a``, remain two words.
    """
    words = list(words[: number + 1])
    if number >= len(words):  # the incomplete word is empty
        words.append("")
    joined: list[str] = []
    prefix = ""
    glued = False
    for word in words:
        if word in ("=", ":") and joined:
            if word == "=" and joined[-1].startswith("--"):
                joined.append("")
            else:
                joined[-1] += word
            prefix, glued = joined[-1], True
        elif glued:
            joined[-1] += word
            glued = False
        else:
            joined.append(word)
            prefix = ""
    return joined, len(joined) - 1, prefix
