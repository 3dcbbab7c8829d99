"""Finds the known word that is most similar to a misspelled word, for hints in messages."""

from __future__ import annotations

from collections.abc import Iterable

from thorvaldc.diagnostics.report import Proposal


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Returns the known word most similar to ``word``, or ``None`` if no word is similar.

    The comparison of words ignores upper and lower case.  The comparison of words treats the
    characters ``-``, ``_`` and space as equal.
    """
    candidates = list(dict.fromkeys(known))
    by_normal = {_normal(candidate): candidate for candidate in reversed(candidates)}
    normal = _normal(word)
    if normal in by_normal:
        return by_normal[normal]
    if len(normal) > 100:
        return None
    import difflib

    close = difflib.get_close_matches(normal, list(by_normal), n=1, cutoff=0.6)
    return by_normal[close[0]] if close else None


def did_you_mean(
    word: str, known: Iterable[str], otherwise: str | None = None, *, fixable: bool = True
) -> str | None:
    """Returns the hint ``did you mean `x`?`` for a misspelled word.

    The hint is a ``Proposal`` to replace the source span of the diagnostic by the known word.  If
    the source span is not that of the word, ``fixable`` is false and the hint is plain text.  If no
    known word is similar to the misspelled word, returns the text ``otherwise``.
    """
    known_word = nearest(word, known)
    if known_word is None:
        return otherwise
    hint = f"did you mean `{known_word}`?"
    return Proposal(hint, known_word, word=word) if fixable else hint


def _normal(word: str) -> str:
    return word.casefold().replace("-", "_").replace(" ", "_")
