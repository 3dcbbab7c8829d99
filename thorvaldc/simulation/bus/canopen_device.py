"""What every CANopen device does (CiA 301): states, heartbeat, emergencies, SDO, LSS, storing."""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from thorvaldc.can import lss as lss_layer
from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame
from thorvaldc.simulation.bus import lss_slave as lss
from thorvaldc.simulation.bus.object_dictionary import (
    STORE_REFUSED,
    Entry,
    Later,
    ObjectDictionary,
    SdoAbort,
)
from thorvaldc.simulation.bus.pdo import PdoSet
from thorvaldc.simulation.bus.sdo_server import SdoServer
from thorvaldc.simulation.bus.simulated_device import BITRATE, SimulatedDevice
from thorvaldc.simulation.bus.wire import Wire

BOOT_TIME = 0.1
"""s from power to the boot-up message, and up to a tenth more."""
SAVE, LOAD = 0x65766173, 0x64616F6C
"""`save` and `load`, the signatures of 0x1010 and 0x1011."""
NODE_ID, PARAMETERS = "node_id", "parameters"
CONSUMERS = 4
EMCY_HEARTBEAT, EMCY_PASSIVE, EMCY_RECOVERED = 0x8130, 0x8120, 0x8140
GENERIC_ERROR, COMMUNICATION_ERROR = 0x01, 0x10


class NmtState(enum.IntEnum):
    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


@dataclass(frozen=True, slots=True)
class Profile:
    """What a CANopen device says of itself and can do.

    ``serial`` ``None``: it has no serial number, and no LSS.  ``bitrates`` (bit/s):
    those that it can do.  ``operational_at_start``: it does not wait for NMT.
    """

    device_type: int = 0
    vendor: int = 0
    product: int = 0
    revision: int = 0
    serial: int | None = None
    name: str = ""
    hardware: str = "1.0"
    software: str = "1.0"
    heartbeat_period: float = 0.1
    bitrates: tuple[int, ...] = tuple(lss_layer.BITRATES.values())
    operational_at_start: bool = False


class CanopenDevice(SimulatedDevice):
    """A device with a node id.  Subclasses add objects, PDOs and what they are for.

    ``nonvolatile`` holds ``node_id`` (255: none yet) and the stored ``parameters``.  An id or a
    bitrate set by LSS is pending: the id is taken on by an NMT reset of the
    communication, stored by LSS's store.  Power on and an NMT reset of the node start from
    what is stored.
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        node_id: int,
        profile: Profile,
        *,
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        start = {NODE_ID: node_id, PARAMETERS: {}, **(nonvolatile or {})}
        super().__init__(name, wire, bitrate, seed=seed, nonvolatile=start)
        self.profile = profile
        self.node_id = lss_layer.UNCONFIGURED
        self.state = NmtState.INITIALISING
        self.heartbeat_stopped = False
        self.boot_time = BOOT_TIME
        self.objects = ObjectDictionary()
        self.pdos: PdoSet | None = None
        self.lss: lss.LssSlave | None = None
        self._sdo = SdoServer(self.objects, self._respond)
        self._pending_id = node_id
        self._pending_rate = bitrate
        self._history: list[int] = []
        self._error_register = 0
        self._heard: dict[int, float] = {}
        self._was_bus_off = False
        self.controller.on_state = self._bus_state

    # -- what subclasses say -----------------------------------------------------------------

    def build(self, objects: ObjectDictionary) -> None:
        """Add the device's own objects; called at every start."""

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet | None:
        """Its PDOs, after its objects."""
        return None

    def ready(self) -> None:
        """It has an id, its objects are there, and it has said so."""

    def entered(self, state: NmtState) -> None:
        """The NMT state has changed."""

    def communication_error(self) -> None:
        """A heartbeat is missing, or the controller went bus-off: what object 0x1029 says."""
        reaction = self.objects[0x1029, 1].value
        if reaction == 0 and self.state is NmtState.OPERATIONAL:
            self.enter(NmtState.PRE_OPERATIONAL)
        elif reaction == 2:
            self.enter(NmtState.STOPPED)

    # -- start and stop -------------------------------------------------------------------------

    def start(self) -> None:
        self.node_id = lss_layer.UNCONFIGURED
        self._pending_id = self.nonvolatile.get(NODE_ID, lss_layer.UNCONFIGURED)
        self._pending_rate = self.nonvolatile.get(BITRATE, self.controller.bitrate)
        self.state = NmtState.INITIALISING
        self._error_register = 0
        self._history = []
        self._was_bus_off = False
        self.after(self.boot_time * (1.0 + self.random.random() / 10.0), self._initialise)

    def stop(self) -> None:
        self.state = NmtState.INITIALISING
        self.node_id = lss_layer.UNCONFIGURED
        self.pdos = None
        self.lss = None

    def change_node_id(self, node_id: int) -> None:
        """As if somebody had set it: nonvolatile, and taken on with a reset."""
        self.nonvolatile[NODE_ID] = node_id
        if self.powered:
            self.reset_node()

    def reset_node(self) -> None:
        """As after power on, but that the CAN controller goes on."""
        self._life += 1
        self.handlers = {}
        self.stop()
        self.start()

    def reset_communication(self) -> None:
        """Communication objects as stored, and the pending node id."""
        self._life += 1
        self.handlers = {}
        self.enter(NmtState.INITIALISING)
        self.after(self.boot_time / 10.0, self._initialise)

    def _initialise(self) -> None:
        self.node_id = self._pending_id
        self._heard = {}
        self.handlers = {}
        profile = self.profile
        if profile.serial is not None:
            identity = lss_layer.Identity(
                profile.vendor, profile.product, profile.revision, profile.serial
            )
            self.lss = lss.LssSlave(
                identity,
                lambda data: self.send(lss_layer.RESPONSE, data),
                lambda: self.node_id,
                set_id=self._set_pending_id,
                set_bitrate=self._set_pending_rate,
                activate=self._activate_rate,
                store=self._store_lss,
                left=self._lss_left,
            )
            slave = self.lss
            self.handlers[lss_layer.REQUEST] = lambda frame: slave.request(frame.data)
        if self.node_id == lss_layer.UNCONFIGURED:
            return
        self.objects = objects = ObjectDictionary()
        self._add_standard(objects)
        self.build(objects)
        self.pdos = self.make_pdos(objects)
        objects.restore(self.nonvolatile.get(PARAMETERS, {}))
        self._sdo = SdoServer(objects, self._respond)
        self.handlers[0x000] = self._nmt
        self.handlers[0x080] = self._sync
        self.handlers[0x600 + self.node_id] = self._sdo_request
        self._listen()
        self.send(0x700 + self.node_id, b"\0")
        self.every(self._heartbeat_period, self._heartbeat, first=self._heartbeat_period())
        self.every(lambda: 0.02, self._look_for_heartbeats)
        self.state = NmtState.PRE_OPERATIONAL
        self.ready()
        if profile.operational_at_start:
            self.enter(NmtState.OPERATIONAL)

    # -- objects ----------------------------------------------------------------------------------

    def _add_standard(self, objects: ObjectDictionary) -> None:
        profile = self.profile
        objects.add(0x1000, 0, Entry("u32", profile.device_type, "const"))
        objects.add(0x1001, 0, Entry("u8", read=lambda: self._error_register))
        objects.add(0x1003, 0, Entry("u8", 0, "rw", read=self._errors, write=self._clear, upper=0))
        for place in range(8):
            objects.add(0x1003, place + 1, Entry("u32", read=partial(self._error, place)))
        objects.add(0x1005, 0, Entry("u32", 0x80, "rw", lower=0x80, upper=0x80))
        objects.add(0x1008, 0, Entry("text", profile.name, "const"))
        objects.add(0x1009, 0, Entry("text", profile.hardware, "const"))
        objects.add(0x100A, 0, Entry("text", profile.software, "const"))
        objects.add_record(0x1010, Entry("u32", 1, "rw", read=lambda: 1, write=self._save))
        objects.add_record(0x1011, Entry("u32", 1, "rw", read=lambda: 1, write=self._restore))
        own = 0x80 + self.node_id
        objects.add(0x1014, 0, Entry("u32", own, "rw", lower=own, upper=own))
        objects.add(0x1015, 0, Entry("u16", 0, "rw", stored=True))
        objects.add_record(0x1016, *(Entry("u32", 0, "rw", stored=True) for _ in range(CONSUMERS)))
        period = round(profile.heartbeat_period * 1000.0)
        objects.add(0x1017, 0, Entry("u16", period, "rw", stored=True))
        numbers = [profile.vendor, profile.product, profile.revision]
        if profile.serial is not None:
            numbers.append(profile.serial)
        objects.add_record(0x1018, *(Entry("u32", number, "const") for number in numbers))
        objects.add_record(0x1029, Entry("u8", 0, "rw", upper=2, stored=True))
        objects.add_record(
            0x1200,
            Entry("u32", 0x600 + self.node_id, "const"),
            Entry("u32", 0x580 + self.node_id, "const"),
        )

    def _save(self, value: Any) -> Later:
        if value != SAVE:
            raise SdoAbort(STORE_REFUSED)
        parameters = self.objects.parameters()
        return lambda done: self.keep({PARAMETERS: parameters}, done)

    def _restore(self, value: Any) -> Later:
        """The values from the factory, from the next reset on."""
        if value != LOAD:
            raise SdoAbort(STORE_REFUSED)
        return lambda done: self.keep({PARAMETERS: {}}, done)

    # -- SDO and PDO ---------------------------------------------------------------------------

    def _sdo_request(self, frame: CanFrame) -> None:
        if self.state is not NmtState.STOPPED:
            self._sdo.request(frame.data)
            self._listen()

    def _respond(self, data: bytes) -> None:
        self.send(0x580 + self.node_id, data)

    def _listen(self) -> None:
        """Take the frames that the objects name: PDOs and others' heartbeats."""
        for place in range(1, CONSUMERS + 1):
            other = self.objects[0x1016, place].value >> 16 & 0x7F
            if other:
                self.handlers[0x700 + other] = self._heartbeat_heard
        if self.pdos is not None:
            for cob_id in self.pdos.cob_ids():
                self.handlers[cob_id] = self._pdo

    def _pdo(self, frame: CanFrame) -> None:
        if self.state is NmtState.OPERATIONAL and self.pdos is not None:
            self.pdos.receive(frame)

    def _sync(self, frame: CanFrame) -> None:
        if self.state is NmtState.OPERATIONAL and self.pdos is not None:
            self.pdos.synchronise()

    # -- NMT --------------------------------------------------------------------------------------

    def _nmt(self, frame: CanFrame) -> None:
        if len(frame.data) != 2 or frame.data[1] not in (0, self.node_id):
            return
        command = frame.data[0]
        if command == 1:
            self.enter(NmtState.OPERATIONAL)
        elif command == 2:
            self.enter(NmtState.STOPPED)
        elif command == 128:
            self.enter(NmtState.PRE_OPERATIONAL)
        elif command == 129:
            self.reset_node()
        elif command == 130:
            self.reset_communication()

    def enter(self, state: NmtState) -> None:
        if state is not self.state:
            self.state = state
            self.entered(state)

    def _heartbeat_period(self) -> float:
        period: int = self.objects[0x1017, 0].value
        return period / 1000.0

    def _heartbeat(self) -> None:
        if not self.heartbeat_stopped:
            self.send(0x700 + self.node_id, bytes([self.state]))

    def _heartbeat_heard(self, frame: CanFrame) -> None:
        other = frame.id - 0x700
        if self._consumer_time(other) > 0.0:
            self._heard[other] = self.now

    def _consumer_time(self, other: int) -> float:
        for place in range(1, CONSUMERS + 1):
            value: int = self.objects[0x1016, place].value
            if value >> 16 & 0x7F == other and other:
                return (value & 0xFFFF) / 1000.0
        return 0.0

    def _look_for_heartbeats(self) -> None:
        """A producer is watched from its first heartbeat on."""
        for other, heard in list(self._heard.items()):
            limit = self._consumer_time(other)
            if limit <= 0.0:
                del self._heard[other]
            elif self.now - heard > limit:
                del self._heard[other]
                self.emergency(EMCY_HEARTBEAT, COMMUNICATION_ERROR, bytes([other]))
                self.communication_error()

    # -- emergencies ---------------------------------------------------------------------------

    def emergency(self, code: int, register: int = GENERIC_ERROR, more: bytes = b"") -> None:
        """Tell of an error that has come; code 0: all are gone."""
        if code:
            self._error_register |= register | GENERIC_ERROR
            self._history.insert(0, code)
            del self._history[8:]
        else:
            self._error_register = 0
        if self.node_id != lss_layer.UNCONFIGURED and self.state is not NmtState.STOPPED:
            data = struct.pack("<HB", code, self._error_register) + more[:5].ljust(5, b"\0")
            self.send(0x80 + self.node_id, data)

    def _errors(self) -> int:
        return len(self._history)

    def _error(self, place: int) -> int:
        return self._history[place] if place < len(self._history) else 0

    def _clear(self, value: Any) -> Later | None:
        self._history = []
        return None

    def _bus_state(self, state: ErrorState) -> None:
        """The CAN controller's error state; after bus-off it has just come back."""
        if not self.powered or self.state is NmtState.INITIALISING:
            return
        if state is ErrorState.PASSIVE:
            self.emergency(EMCY_PASSIVE, COMMUNICATION_ERROR)
        elif state is ErrorState.BUS_OFF:
            self._was_bus_off = True
            self.communication_error()
        elif self._was_bus_off:
            self._was_bus_off = False
            self.emergency(EMCY_RECOVERED, COMMUNICATION_ERROR)

    # -- LSS --------------------------------------------------------------------------------------

    def _set_pending_id(self, node_id: int) -> None:
        self._pending_id = node_id

    def _set_pending_rate(self, bitrate: int) -> bool:
        if bitrate not in self.profile.bitrates:
            return False
        self._pending_rate = bitrate
        return True

    def _store_lss(self, done: Callable[[int], None]) -> None:
        wanted = {NODE_ID: self._pending_id, BITRATE: self._pending_rate}
        self.keep(wanted, lambda: done(0))

    def _lss_left(self) -> None:
        """A device without an id takes one on at once (CiA 305); others wait for a reset."""
        if self.node_id == lss_layer.UNCONFIGURED and self._pending_id != lss_layer.UNCONFIGURED:
            self.reset_communication()

    def _activate_rate(self, delay: float) -> None:
        """Silent for one delay, then the other bitrate, then silent for one more."""
        self.controller.listen_only = True

        def change() -> None:
            self.controller.bitrate = self._pending_rate
            self.controller.restart()
            self.after(delay, speak)

        def speak() -> None:
            self.controller.listen_only = False

        self.after(delay, change)
