"""What goes wrong on a simulated bus, and when: a script of faults, everything in SI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from thorvaldc.diagnostics import Span


class FaultKind(NamedTuple):
    """What a kind of fault needs and may have besides when it begins.

    ``node``: ``yes`` (it is one device's), ``maybe`` (or the whole bus's) or ``no``.
    ``lasts``: whether it can end.
    """

    node: str
    needs: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    lasts: bool = True


FAULT_KINDS = {
    "power_cut": FaultKind("maybe"),
    "mute": FaultKind("yes"),
    "heartbeat_stop": FaultKind("yes"),
    "duplicate_id": FaultKind("yes", ("id",), lasts=False),
    "babble": FaultKind("yes", ("cob_id", "period")),
    "emcy": FaultKind("yes", ("code",), ("register",), lasts=False),
    "frozen_encoder": FaultKind("yes", ("channel",)),
    "blocked_motor": FaultKind("yes", ("channel",)),
    "wrong_bitrate": FaultKind("yes", ("bitrate",)),
    "bus_off": FaultKind("yes", lasts=False),
    "lost_frames": FaultKind("maybe", ("share",), ("cob_id",)),
    "noise": FaultKind("no", ("share",)),
}


@dataclass(frozen=True, slots=True)
class BusFault:
    """A fault on ``bus``, of its ``node`` or (``None``) of all.

    It begins at ``time`` (s), or in the middle of the bus's ``frame``-th frame (from 1),
    ``delay`` s later; it lasts for ``duration`` s, or (``None``) to the end.

    ``id`` is the node id that a device has all of a sudden, ``cob_id`` and ``period`` (s)
    what it babbles; ``code`` and ``register`` are those of an emergency; ``channel`` is the
    motor's; ``bitrate`` in bit/s; ``share`` of the frames, 0..1.
    """

    kind: str
    bus: str
    node: str | None
    time: float | None
    frame: int | None
    span: Span
    delay: float = 0.0
    duration: float | None = None
    id: int = 0
    cob_id: int | None = None
    period: float = 0.0
    code: int = 0
    register: int = 0
    channel: str = ""
    bitrate: int = 0
    share: float = 0.0


@dataclass(frozen=True, slots=True)
class BusFaults:
    """A script of faults; ``seed`` is that of everything that happens by chance."""

    faults: tuple[BusFault, ...]
    seed: int = 0
    description: str = ""
