"""A stop that is released only by the program that has engaged it."""

from __future__ import annotations

THIS_PROGRAM = "this program"
"""Owner of the stops and twist sources that are used in the process of the base driver."""

_ENDED = ", which has ended"


class OwnedStop:
    """A stop with the programs that have engaged it.

    The stop is engaged as long as at least one program has engaged it and has not released it.  A
    program that ends does not release its stops; afterwards only ``force`` releases them.

    - ``owners``: programs that have engaged the stop, also those that have ended.
    """

    def __init__(self) -> None:
        self.owners: tuple[str, ...] = ()

    @property
    def engaged(self) -> bool:
        return bool(self.owners)

    def engage(self, owner: str) -> None:
        if owner not in self.owners:
            self.owners = (*self.owners, owner)

    def note_end(self, owner: str) -> None:
        """Marks a program as ended, if it is an owner of the stop."""
        self.owners = tuple(name + _ENDED if name == owner else name for name in self.owners)

    def release(self, owner: str, force: bool = False) -> str:
        """Releases the stop of one program, or with ``force`` the stops of all programs.

        Returns the reason if another program has engaged the stop, else an empty text.
        """
        others = () if force else tuple(name for name in self.owners if name != owner)
        self.owners = others
        if not others:
            return ""
        lives = not all(name.endswith(_ENDED) for name in others)
        return (
            f"the stop was set by {' and '.join(others)}; release it"
            f"{' there, or' if lives else ''} with `force=true`"
            ' (in JSON: "force": true)'
        )
