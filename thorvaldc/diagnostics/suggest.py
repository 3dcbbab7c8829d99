"""The nearest known word to an unknown one, for hints."""

from __future__ import annotations

from collections.abc import Iterable


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that ``word`` was probably meant to be, or ``None``.

    Case and the choice of ``-``, ``_`` or a space do not count as differences.
    """
    candidates = list(dict.fromkeys(known))
    by_plain = {_plain(candidate): candidate for candidate in reversed(candidates)}
    plain = _plain(word)
    if plain in by_plain:
        return by_plain[plain]
    if len(plain) > 100:
        return None
    import difflib

    close = difflib.get_close_matches(plain, list(by_plain), n=1, cutoff=0.6)
    return by_plain[close[0]] if close else None


def did_you_mean(word: str, known: Iterable[str], otherwise: str | None = None) -> str | None:
    """``did you mean `x`?`` where a known word is near, else ``otherwise``."""
    found = nearest(word, known)
    return f"did you mean `{found}`?" if found is not None else otherwise


def _plain(word: str) -> str:
    return word.casefold().replace("-", "_").replace(" ", "_")
