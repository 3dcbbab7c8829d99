"""Words of the language that older files contain, and what stands in their place.

This is the only table of them.  The compiler names ``thorvaldc upgrade`` in its hint where it meets
such a word, and this command rewrites the words that have a new name.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

UPGRADE = "`thorvaldc upgrade FILE`"


class OldWord(NamedTuple):
    """A key, or a value of a key, that the language had.

    - ``kinds``: kinds of documents that contain it.
    - ``path``: keys from the top of the document; ``*`` is any key.
    - ``new``: the word in its place, or empty if a person must decide.
    - ``advice``: what to write, if a person must decide.
    - ``value``: old value of the key; empty if the key itself is old.
    - ``types``: module types with this parameter, for a key of ``params``.
    """

    kinds: tuple[str, ...]
    path: tuple[str, ...]
    new: str = ""
    advice: str = ""
    value: str = ""
    types: tuple[str, ...] = ()

    @property
    def hint(self) -> str:
        """The hint of a diagnostic about the word."""
        if self.new:
            return f"it is `{self.new}` now; {UPGRADE} writes it"
        return self.advice


_RANDOM_PAIRS = (
    "this calculator is a package of its own: `pip install bench/random_pairs` in a checkout of"
    " thorvaldc; `general` is for the same bases"
)
OLD_WORDS: tuple[OldWord, ...] = (
    OldWord(
        ("robot", "module"),
        ("modules", "*", "params", "leg_drop"),
        advice="write `height`, from the mount down to the ground: `leg_drop` and the radius of the"
        " wheel",
        types=("assembly/fixed_drive",),
    ),
    OldWord(
        ("robot", "module"),
        ("modules", "*", "params", "leg_drop"),
        advice="write `height`, from the mount down to the ground: `leg_drop`, the radius of the"
        " wheel and 160 mm of the steering",
        types=("assembly/steered_drive", "assembly/suspended_steered_drive"),
    ),
    OldWord(
        ("scenario",),
        ("variations",),
        advice="run a sweep: `thorvaldc scenario FILE --set world.friction=0.3,0.6`",
    ),
    OldWord(("robot",), ("base_calculator",), advice=_RANDOM_PAIRS, value="random_pairs"),
    OldWord(("robot",), ("base_calculator", "name"), advice=_RANDOM_PAIRS, value="random_pairs"),
)


def old_keys(kind: str, path: Sequence[str | int]) -> Iterator[OldWord]:
    """Yields the old keys of a kind of document at a path, which ends with the key."""
    for word in OLD_WORDS:
        if not word.value and kind in word.kinds and _matches(word.path, path):
            yield word


def old_value(kind: str, path: Sequence[str | int], value: object) -> OldWord | None:
    """Returns the old value of a kind of document at the path of its key, or ``None``."""
    for word in OLD_WORDS:
        is_same = word.value and word.value == value and kind in word.kinds
        if is_same and _matches(word.path, path):
            return word
    return None


def old_parameter(module_type: str, name: str) -> OldWord | None:
    """Returns the old parameter of a module type, or ``None``."""
    for word in OLD_WORDS:
        if module_type in word.types and word.path[-1] == name:
            return word
    return None


def _matches(pattern: Sequence[str], path: Sequence[str | int]) -> bool:
    return len(pattern) == len(path) and all(
        expected in ("*", key) for expected, key in zip(pattern, path, strict=True)
    )
