"""The bus in the model: nodes, frame definitions, signals and CANopen objects."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.diagnostics import Span
from thorvaldc.model.element import Element

Scalar = bool | int | float | str

# Data types of CANopen objects (CiA 301) that the model uses: index and length in bits.
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
    """A little-endian field of a CAN frame: physical value = raw value * scale + offset.

    ``start`` and ``length`` are in bits.  ``joint`` is the joint that the value belongs to; the
    ``unit`` is then that of the joint (rad/s or rad).  ``multiplexer`` marks
    the selector; ``selected_by`` lists the selector values with which the
    frame contains this signal.  ``choices`` are names of raw values.
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
    """The layout and the timing of a CAN frame with an 11-bit identifier.

    ``producer`` and ``consumers`` are names of nodes, or ``master``. ``kind`` is ``pdo``, ``sdo``,
    ``heartbeat``, ``emcy``, ``sync``, ``nmt``, ``broadcast`` or ``relay`` (the frame of a foreign
    device that the driver forwards).  ``period`` and ``deadline`` are in s, ``None`` for a frame
    that is sent on demand.  Frames on demand are at least ``minimum_interval`` s apart (``None``:
    see ``bus_timing``).  ``response_time`` (s) is the longest time from the instant at which the
    frame is due until it is received, ``None`` if there is no bound.

    ``pdo`` is the number of a CANopen PDO (1..512), ``mapping`` lists the objects in
    it as (index, subindex, type).  A ``synchronous`` PDO is sent, or takes effect, at the SYNC.
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
    """A channel of a motor controller, and the actuator on it (``None``: not connected)."""

    name: str
    role: str
    actuator: str | None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ObjectValue(Element):
    """An entry of a node's object dictionary, and its required value.

    ``type`` is one of ``OBJECT_TYPES``; ``access`` is ``ro`` or ``rw``.  The value of an
    ``ro`` entry identifies the node: the node must report it.  ``value`` is ``None`` if the entry
    changes while the node runs, or if no value is required.
    """

    name: str
    index: int
    subindex: int
    type: str
    value: int | None
    access: str = "rw"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Node(Element):
    """A device on a bus.

    ``id`` is unique within its ``id_space``: the ids of batteries are separate from CANopen node
    ids. Foreign devices without an id have an empty ``id_space`` and the id 0. ``automatic``: the
    compiler chose the id and the lock file keeps it. ``vendor_id``, ``product_code`` and
    ``revision_number`` are those of object 0x1018, ``device_type`` is object 0x1000.  ``lss``: the
    node id can be written by LSS (CiA 305). ``heartbeat_timeout`` (s) is the silence after which
    the master considers the node lost, ``heartbeat_consumer_time`` (s) the silence after which the
    node considers the master lost (object 0x1016); ``None``: no supervision.  ``bitrates`` lists
    the supported ones in bit/s; empty: any.  ``objects`` are in the order of index and subindex.
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
        """True for a drive of device profile CiA 402, according to its device type."""
        return self.device_type is not None and self.device_type & 0xFFFF == CIA_402


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bus(Element):
    """A CAN bus with its nodes and frames.

    ``bitrate`` in bit/s; ``sync_period`` in s is the control cycle.  ``master_id`` is the CANopen
    node id of the master.  ``load`` is the worst-case bus load, 0..1.
    """

    name: str
    bitrate: int
    sync_period: float
    nodes: tuple[Node, ...]
    frames: tuple[FrameDefinition, ...]
    span: Span
    master_id: int = 127
    load: float = 0.0
