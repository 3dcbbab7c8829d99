"""A script of faults to inject into a simulated bus.  All values in SI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from thorvaldc.diagnostics import Span


class FaultKind(NamedTuple):
    """The fields of a kind of fault.

    ``node``: ``yes`` (the fault affects one device), ``no`` (it affects the bus) or ``maybe``
    (either). ``needs`` lists the required fields, ``may`` the optional ones.  ``lasts``: the fault
    may have a ``duration``.
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
    """An injected fault of a ``node`` of ``bus``, or of all its nodes (``None``).

    It begins ``delay`` s after ``time`` (s), or after the middle of the ``frame``-th frame of the
    bus (from 1).  It lasts for ``duration`` s, or until the end of the run (``None``).

    ``id`` is the node id that the device takes.  ``cob_id`` and ``period`` (s) are those of the
    frames that it sends without being asked.  ``code`` and ``register`` are the error code and the
    error register of an EMCY.  ``channel`` is the channel of the motor.  ``bitrate`` in bit/s.
    ``share`` is the fraction of the frames that are affected, 0..1.
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
    """A script of faults.  ``seed`` is the seed for all random numbers."""

    faults: tuple[BusFault, ...]
    seed: int = 0
    description: str = ""
