"""The bus's part of the model: nodes, frames and signals, with what CANopen needs to know."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.diagnostics import Span
from thorvaldc.model.element import Element

Scalar = bool | int | float | str

# Types of CANopen objects that occur here (CiA 301), with their numbers and lengths in bits.
OBJECT_TYPES = {
    "boolean": (0x0001, 1),
    "integer8": (0x0002, 8),
    "integer16": (0x0003, 16),
    "integer32": (0x0004, 32),
    "unsigned8": (0x0005, 8),
    "unsigned16": (0x0006, 16),
    "unsigned32": (0x0007, 32),
}
CIA_402 = 402


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Signal(Element):
    """A field of a frame, little endian: physical = raw * scale + offset.

    ``start`` and ``length`` in bits.  ``joint`` names the joint that the value
    is about, with ``unit`` then at the joint (rad/s, rad).  ``multiplexer`` marks
    the selector; ``selected_by`` lists the selector values under which the
    signal is present.  ``choices`` names raw values.
    """

    name: str
    start: int
    length: int
    signed: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    joint: str | None = None
    multiplexer: bool = False
    selected_by: tuple[int, ...] = ()
    choices: tuple[tuple[int, str], ...] = ()
    description: str = ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrameDefinition(Element):
    """A standard CAN frame; ``producer``/``consumers`` are node names or ``master``.

    ``kind`` is ``pdo``, ``sdo``, ``heartbeat``, ``emcy``, ``sync``, ``nmt``,
    ``broadcast`` or ``relay`` (a foreign device's, passed on).  ``period`` and
    ``deadline`` in s, ``None`` for a frame sent on demand; such frames are at least
    ``minimum_interval`` s apart (``None``: see ``bus_timing``).  ``response_time``
    (s) is the longest from when it is due until it is received, ``None`` where
    there is no bound.

    A CANopen PDO has a number, ``pdo`` (1..512), ``mapping`` lists the objects in
    it as (index, subindex, type), and with ``synchronous`` it is sent, or takes
    effect, at the SYNC.
    """

    name: str
    cob_id: int
    kind: str
    producer: str
    consumers: tuple[str, ...]
    length: int
    period: float | None
    deadline: float | None
    signals: tuple[Signal, ...]
    span: Span
    description: str = ""
    minimum_interval: float | None = None
    response_time: float | None = None
    pdo: int | None = None
    mapping: tuple[tuple[int, int, str], ...] = ()
    synchronous: bool = False


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Channel(Element):
    """A channel of a controller and the actuator on it (``None``: not wired)."""

    name: str
    role: str
    actuator: str | None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ObjectValue(Element):
    """An entry of a node's object dictionary, and the value that it is to have.

    ``type`` is one of ``OBJECT_TYPES``, ``access`` ``ro`` or ``rw``.  A value that
    is ``ro`` is what the node must say of itself.  ``value`` ``None``: the entry
    changes as the node runs, or nothing is asked of it.
    """

    name: str
    index: int
    subindex: int
    type: str
    value: int | None
    access: str = "rw"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Node(Element):
    """A device on a bus.  ``id_space`` keeps batteries' ids apart from node ids.

    In an empty ``id_space`` are foreign devices that have no id; theirs is 0.
    ``automatic``: the id was chosen by the compiler and is kept in the lock file.
    ``vendor_id``, ``product_code`` and ``revision_number`` are those of object 0x1018.
    ``device_type`` is object 0x1000.  ``lss``: its id can be written over the bus.
    Times in s: ``heartbeat_timeout`` is the silence after which the master takes
    it for lost, ``heartbeat_consumer_time`` that after which it takes the master
    for lost (object 0x1016); ``None``: not watched.  ``bitrates`` in bit/s that it
    can do, empty: any.  ``objects`` are in the order of index and subindex.
    """

    name: str
    module: str
    protocol: str
    id: int
    id_space: str
    vendor_id: int | None
    serial: str | None
    channels: tuple[Channel, ...]
    properties: tuple[tuple[str, Scalar], ...]
    span: Span
    automatic: bool = False
    product_code: int | None = None
    revision_number: int | None = None
    device_type: int | None = None
    lss: bool = False
    heartbeat_timeout: float | None = None
    heartbeat_consumer_time: float | None = None
    bitrates: tuple[int, ...] = ()
    objects: tuple[ObjectValue, ...] = ()

    @property
    def is_cia402(self) -> bool:
        """Whether it is a drive after CiA 402, by its device type."""
        return self.device_type is not None and self.device_type & 0xFFFF == CIA_402


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bus(Element):
    """A CAN bus: ``bitrate`` bit/s, ``sync_period`` s (the control cycle).

    ``master_id`` is the CANopen node id of the master.  ``load`` is the share of
    the bus's time that is taken at worst, 0..1.
    """

    name: str
    bitrate: int
    sync_period: float
    nodes: tuple[Node, ...]
    frames: tuple[FrameDefinition, ...]
    span: Span
    master_id: int = 127
    load: float = 0.0
