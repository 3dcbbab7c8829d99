"""A simulated CANopen device (CiA 301) with NMT, heartbeat, EMCY, SDO, PDOs and LSS.

Messages and NMT states of a device after power-on:

    power --boot time--> boot-up (0x700 + id: 00) --period--> heartbeat (7F) --period--> ...
          INITIALISING |  PRE_OPERATIONAL: SDO            | NMT start: OPERATIONAL, PDOs too

A device without a node id sends no boot-up message and no heartbeat.  A device without a node id
answers only LSS requests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from thorvaldc.can import canopen, lss
from thorvaldc.can.canopen import LSS_REQUEST, LSS_RESPONSE, Emergency, NmtCommand, NmtState
from thorvaldc.can.frame import CanFrame, ErrorState
from thorvaldc.can.sdo import AbortCode
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus import simulated_device
from thorvaldc.simulation.bus.object_dictionary import (
    DelayedWrite,
    Entry,
    ObjectDictionary,
    SdoAbort,
    described_objects,
)
from thorvaldc.simulation.bus.process_data import PdoSet
from thorvaldc.simulation.bus.sdo_server import LssSlave, SdoServer

BOOT_TIME = 0.1
"""Time (s) from power-on to the boot-up message.  A random time of up to 10 % is added."""
SAVE, LOAD = 0x65766173, 0x64616F6C
"""Signatures of objects 0x1010 and 0x1011: the ASCII texts `save` and `load`."""
CONSUMERS = 4
"""Number of entries of object 0x1016 (consumer heartbeat time)."""
HISTORY = 8
"""Number of entries of object 0x1003 (error history)."""
EMCY_HEARTBEAT, EMCY_PASSIVE, EMCY_RECOVERED = 0x8130, 0x8120, 0x8140
GENERIC_ERROR, COMMUNICATION_ERROR = 0x01, 0x10
"""Bits of the error register (0x1001)."""


class CanopenDevice(simulated_device.SimulatedDevice):
    """A simulated CANopen device.  A subclass adds object dictionary entries, PDOs and the
    behaviour of the device.

    The mapping ``nonvolatile`` contains the ``node_id`` (255 for a device without a node id) and
    the stored ``parameters``.  A node id or a bitrate that an LSS service sets is pending at first.
    An NMT reset of the communication applies the pending node id.  The LSS service "store
    configuration" writes the pending node id and the pending bitrate to non-volatile memory.  The
    device loads the node id, the bitrate and the parameters from non-volatile memory at power-on
    and at an NMT reset of the node.

    ``device_name`` and ``device_type`` are those of nodes without a device type of their own.
    """

    device_name, device_type = "", 0

    def __init__(
        self,
        specification: simulated_device.DeviceSpecification,
        memory: Mapping[str, Any] | None = None,
    ) -> None:
        stored = simulated_device.commissioned_memory(specification)
        super().__init__(specification, {**stored, **(memory or {})})
        self.node_id = lss.UNCONFIGURED
        self.state = NmtState.INITIALISING
        self.heartbeat_stopped = False
        self.commands_ignored = False
        """``True`` if received PDOs are ignored, as by a task of the device that hangs."""
        self.sync_ignored = False
        """``True`` if SYNC is ignored."""
        self.nmt_ignored = False
        """``True`` if NMT commands are ignored."""
        self._frozen_reports = False
        self.boot_time = BOOT_TIME
        self.objects = ObjectDictionary()
        self.pdos: PdoSet | None = None
        self.lss: LssSlave | None = None
        self._sdo = SdoServer(self.objects, self._respond)
        self._quirks = specification.quirks
        self._pending_id = lss.UNCONFIGURED
        self._pending_rate = self.factory_bitrate
        self._history: list[int] = []
        self._error_register = 0
        self._heartbeats: dict[int, float] = {}
        """Time (s) of the last heartbeat of each watched node."""
        self._was_bus_off = False
        self.controller.on_state = self._error_state_changed

    @property
    def serial(self) -> int | None:
        """Serial number, or ``None`` for a device without a serial number and without LSS."""
        serial = self.specification.nonvolatile.get(simulated_device.SERIAL)
        return None if serial is None else int(serial, 16)

    @property
    def _product(self) -> tuple[int, int, int]:
        """Vendor, product and revision in object 0x1018."""
        node = self.specification.node
        return node.vendor_id or 0, node.product_code or 0, node.revision_number or 0

    # -- for subclasses -----------------------------------------------------------------------

    def add_objects(self, objects: ObjectDictionary) -> None:
        """Adds the objects of the device to the object dictionary.

        The base class calls ``add_objects`` at every start of the device.
        """

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet | None:
        """Returns the PDOs of the device.

        The base class calls ``make_pdos`` after ``add_objects``.
        """
        return None

    def initialised(self) -> None:
        """Starts the timers of the device.

        The base class calls ``initialised`` after the boot-up message.
        """

    def nmt_state_changed(self, state: NmtState) -> None:
        """Reacts to a change of the NMT state.

        The base class calls ``nmt_state_changed`` after each change of the NMT state.
        """

    def communication_error(self) -> None:
        """Reacts to a missing heartbeat or bus-off as object 0x1029 defines."""
        reaction = self.objects[0x1029, 1].value
        if reaction == 0 and self.state is NmtState.OPERATIONAL:
            self.enter(NmtState.PRE_OPERATIONAL)
        elif reaction == 2:
            self.enter(NmtState.STOPPED)

    # -- start and stop -------------------------------------------------------------------------

    def start(self) -> None:
        self.node_id = lss.UNCONFIGURED
        self._pending_id = self.nonvolatile.get(simulated_device.NODE_ID, lss.UNCONFIGURED)
        self._pending_rate = self.nonvolatile.get(simulated_device.BITRATE, self.controller.bitrate)
        self.state = NmtState.INITIALISING
        self._error_register = 0
        self._history = []
        self._was_bus_off = False
        self.after(self.boot_time * (1.0 + self.random.random() / 10.0), self._initialise)

    def stop(self) -> None:
        self._end_hung_tasks()
        self.state = NmtState.INITIALISING
        self.node_id = lss.UNCONFIGURED
        self.pdos = None
        self.lss = None

    def _end_hung_tasks(self) -> None:
        """A device that restarts runs all its tasks.

        A task that hangs before the device has started hangs from the start.
        """
        self.commands_ignored = self.sync_ignored = self.nmt_ignored = False
        self.frozen_reports = False

    def change_node_id(self, node_id: int) -> None:
        """Stores a new node id in non-volatile memory and resets the node."""
        self.nonvolatile[simulated_device.NODE_ID] = node_id
        if self.powered:
            self.reset_node()

    def lose_watchdog(self) -> None:
        """Sets all entries of object 0x1016 (consumer heartbeat time) to 0.

        A reset of the node restores the stored entries.
        """
        if self.node_id != lss.UNCONFIGURED:
            for subindex in range(1, CONSUMERS + 1):
                self.objects[0x1016, subindex].value = 0

    def overwrite_object(self, index: int, subindex: int, value: int) -> int | None:
        if self.node_id == lss.UNCONFIGURED or (index, subindex) not in self.objects:
            return None
        entry = self.objects[index, subindex]
        if not entry.can_have(value):
            return None
        previous: int = entry.value
        entry.value = value
        self._add_configured_handlers()
        return previous

    def reset_node(self) -> None:
        """Restarts the device as after power-on, but keeps the CAN controller on the bus."""
        self._life += 1
        self.handlers = {}
        self.stop()
        self.start()

    def reset_communication(self) -> None:
        """Resets the communication objects to the stored values and applies the pending node id."""
        self._life += 1
        self._end_hung_tasks()
        self.handlers = {}
        self.enter(NmtState.INITIALISING)
        self.after(self.boot_time / 10.0, self._initialise)

    def _initialise(self) -> None:
        self.node_id = self._pending_id
        self._heartbeats = {}
        self.handlers = {}
        if self.specification.node.lss and self.serial is not None:
            self._start_lss(self.serial)
        if self.node_id == lss.UNCONFIGURED:
            return
        quirks = self._quirks
        self.objects = objects = ObjectDictionary(length_aborts=Quirk.LENGTH_ABORTS in quirks)
        self._add_standard_objects(objects)
        self.add_objects(objects)
        self.pdos = self.make_pdos(objects)
        if self.pdos is not None:
            self.pdos.apply_quirks(quirks)
            self.pdos.frozen = self.frozen_reports
        described = self.specification.node.described
        served = described_objects(objects, described, self.node_id) if described else objects
        objects.restore(self.nonvolatile.get(simulated_device.PARAMETERS, {}))
        self._sdo = SdoServer(
            served,
            self._respond,
            segmented=Quirk.SEGMENTED_TRANSFERS in quirks,
            blocks=Quirk.BLOCK_TRANSFERS in quirks,
        )
        self.handlers[canopen.NMT] = self._nmt
        self.handlers[canopen.SYNC] = self._sync
        self.handlers[canopen.SDO_REQUEST + self.node_id] = self._sdo_request
        self._add_configured_handlers()
        self.send(canopen.HEARTBEAT + self.node_id, bytes([NmtState.INITIALISING]))
        self.every(self._heartbeat_period, self._heartbeat, first=self._heartbeat_period())
        self.every(lambda: 0.02, self._check_heartbeats)
        self.state = NmtState.PRE_OPERATIONAL
        self.initialised()

    def _start_lss(self, serial: int) -> None:
        slave = LssSlave(
            lss.Identity(*self._product, serial),
            lambda data: self.send(LSS_RESPONSE, data),
            lambda: self.node_id,
            set_id=self._set_pending_id,
            set_bitrate=self._set_pending_rate,
            activate=self._activate_rate,
            store=self._store_lss,
            left=self._lss_left,
            responds_when_selected=Quirk.LSS_RESPONDS_WHEN_SELECTED in self._quirks,
        )
        self.lss = slave
        self.handlers[LSS_REQUEST] = lambda frame: slave.request(frame.data)

    # -- objects ----------------------------------------------------------------------------------

    def _add_standard_objects(self, objects: ObjectDictionary) -> None:
        specification = self.specification
        device_type = specification.node.device_type or self.device_type
        objects.add(0x1000, 0, Entry("u32", device_type, "const"))
        objects.add(0x1001, 0, Entry("u8", read=lambda: self._error_register))
        objects.add(
            0x1003,
            0,
            Entry("u8", 0, "rw", read=self._error_count, write=self._clear_errors, upper=0),
        )
        for position in range(HISTORY):
            objects.add(
                0x1003,
                position + 1,
                Entry("u32", read=partial(self._error, position)),
            )
        sync = canopen.SYNC
        cob_access = "ro" if Quirk.FIXED_COB_IDS in self._quirks else "rw"
        objects.add(0x1005, 0, Entry("u32", sync, cob_access, lower=sync, upper=sync))
        objects.add(0x1008, 0, Entry("text", self.device_name or type(self).__name__, "const"))
        for index in (0x1009, 0x100A):  # versions of hardware and software
            objects.add(index, 0, Entry("text", "1.0", "const"))
        objects.add_record(0x1010, Entry("u32", 1, "rw", read=lambda: 1, write=self._save))
        objects.add_record(
            0x1011,
            Entry("u32", 1, "rw", read=lambda: 1, write=self._load_defaults),
        )
        emcy = canopen.EMCY + self.node_id
        objects.add(0x1014, 0, Entry("u32", emcy, cob_access, lower=emcy, upper=emcy))
        objects.add(0x1015, 0, Entry("u16", 0, "rw", stored=True))
        objects.add_record(
            0x1016,
            *(
                Entry("u32", 0, "rw", stored=True, write=partial(self._check_consumer, number))
                for number in range(1, CONSUMERS + 1)
            ),
        )
        in_factory_state = specification.delivered and specification.node.lss
        period = 0 if in_factory_state else round(specification.heartbeat_period * 1000.0)
        objects.add(0x1017, 0, Entry("u16", period, "rw", stored=True))
        identity = [*self._product, *([] if self.serial is None else [self.serial])]
        objects.add_record(0x1018, *(Entry("u32", number, "const") for number in identity))
        objects.add_record(0x1029, Entry("u8", 0, "rw", upper=2, stored=True))
        objects.add_record(
            0x1200,
            Entry("u32", canopen.SDO_REQUEST + self.node_id, "const"),
            Entry("u32", canopen.SDO_RESPONSE + self.node_id, "const"),
        )

    def _save(self, value: Any) -> DelayedWrite:
        if value != SAVE:
            raise SdoAbort(AbortCode.STORE_REFUSED)
        parameters = self.objects.parameters()
        return lambda on_stored: self.store({simulated_device.PARAMETERS: parameters}, on_stored)

    def _load_defaults(self, value: Any) -> DelayedWrite:
        """Handles a write to object 0x1011, "restore default parameters".

        The factory values of the parameters apply after the next reset of the device.
        """
        if value != LOAD:
            raise SdoAbort(AbortCode.STORE_REFUSED)
        return lambda on_stored: self.store({simulated_device.PARAMETERS: {}}, on_stored)

    # -- SDO and PDO ---------------------------------------------------------------------------

    def _sdo_request(self, frame: CanFrame) -> None:
        if self.state is not NmtState.STOPPED:
            self._sdo.request(frame.data)
            self._add_configured_handlers()

    def _respond(self, data: bytes) -> None:
        self.send(canopen.SDO_RESPONSE + self.node_id, data)

    def _add_configured_handlers(self) -> None:
        """Adds handlers for the RPDOs and for the heartbeats of other nodes.

        The object dictionary defines the identifiers of the RPDOs and the nodes whose heartbeat the
        device supervises.
        """
        for subindex in range(1, CONSUMERS + 1):
            producer = self.objects[0x1016, subindex].value >> 16 & 0x7F
            if producer:
                self.handlers[canopen.HEARTBEAT + producer] = self._heartbeat_received
        if self.pdos is not None:
            for cob_id in self.pdos.cob_ids():
                self.handlers[cob_id] = self._pdo

    def _pdo(self, frame: CanFrame) -> None:
        if self.state is not NmtState.OPERATIONAL or self.commands_ignored:
            return
        if self.pdos is not None:
            self.pdos.receive(frame)

    def _sync(self, frame: CanFrame) -> None:
        if self.state is not NmtState.OPERATIONAL or self.sync_ignored:
            return
        if self.pdos is not None:
            self.pdos.synchronise()

    @property
    def frozen_reports(self) -> bool:
        """``True`` if all sent PDOs repeat their last data, or their first data without any."""
        return self._frozen_reports

    @frozen_reports.setter
    def frozen_reports(self, frozen: bool) -> None:
        self._frozen_reports = frozen
        if self.pdos is not None:
            self.pdos.frozen = frozen

    # -- NMT --------------------------------------------------------------------------------------

    def _nmt(self, frame: CanFrame) -> None:
        if len(frame.data) != 2 or frame.data[1] not in (0, self.node_id) or self.nmt_ignored:
            return
        command = frame.data[0]
        if command == NmtCommand.START:
            self.enter(NmtState.OPERATIONAL)
        elif command == NmtCommand.STOP:
            self.enter(NmtState.STOPPED)
        elif command == NmtCommand.ENTER_PRE_OPERATIONAL:
            self.enter(NmtState.PRE_OPERATIONAL)
        elif command == NmtCommand.RESET_NODE:
            self.reset_node()
        elif command == NmtCommand.RESET_COMMUNICATION:
            self.reset_communication()

    def enter(self, state: NmtState) -> None:
        if state is not self.state:
            self.state = state
            self.nmt_state_changed(state)

    def _heartbeat_period(self) -> float:
        period: int = self.objects[0x1017, 0].value
        return period / 1000.0

    def _heartbeat(self) -> None:
        if not self.heartbeat_stopped:
            self.send(canopen.HEARTBEAT + self.node_id, bytes([self.state]))

    def _heartbeat_received(self, frame: CanFrame) -> None:
        producer = frame.id - canopen.HEARTBEAT
        if self._consumer_time(producer) > 0.0:
            self._heartbeats[producer] = self.now

    def _consumer_time(self, producer: int) -> float:
        """Returns the longest time (s) between two heartbeats of a node, from object 0x1016.

        Returns 0 if the device does not supervise the heartbeat of the node.
        """
        for subindex in range(1, CONSUMERS + 1):
            value: int = self.objects[0x1016, subindex].value
            if value >> 16 & 0x7F == producer and producer:
                return (value & 0xFFFF) / 1000.0
        return 0.0

    def _check_consumer(self, number: int, value: Any) -> DelayedWrite | None:
        """Checks a new value of entry ``number`` of object 0x1016."""
        others = [self.objects[0x1016, i].value for i in range(1, CONSUMERS + 1) if i != number]
        producers = {other >> 16 & 0x7F for other in others if other & 0xFFFF}
        is_duplicate = value & 0xFFFF and value >> 16 & 0x7F in producers
        if Quirk.ONE_CONSUMER_PER_NODE in self._quirks and is_duplicate:
            raise SdoAbort(AbortCode.PARAMETER_INCOMPATIBLE)
        return None

    def _check_heartbeats(self) -> None:
        """Reports the nodes whose heartbeat is missing.

        The supervision of the heartbeat of a node begins with the first heartbeat (CiA 301).
        """
        for producer, received_at in list(self._heartbeats.items()):
            limit = self._consumer_time(producer)
            if limit <= 0.0:
                del self._heartbeats[producer]
            elif self.now - received_at > limit:
                del self._heartbeats[producer]
                self.emergency(EMCY_HEARTBEAT, COMMUNICATION_ERROR, bytes([producer]))
                self.communication_error()

    # -- emergencies ---------------------------------------------------------------------------

    def emergency(self, code: int, register: int = GENERIC_ERROR, more: bytes = b"") -> None:
        """Sends an EMCY message for a new device error.

        ``code`` is the EMCY error code.  The EMCY error code 0 means that all device errors are
        cleared.  ``register`` is the value of the error register.  ``more`` has up to 5
        manufacturer-specific data bytes of the EMCY message.
        """
        if code:
            self._error_register |= register | GENERIC_ERROR
            self._history.insert(0, code)
            del self._history[HISTORY:]
        else:
            self._error_register = 0
        if self.node_id != lss.UNCONFIGURED and self.state is not NmtState.STOPPED:
            message = Emergency(code, self._error_register, more)
            self.send(canopen.EMCY + self.node_id, message.pack())

    def _error_count(self) -> int:
        return len(self._history)

    def _error(self, position: int) -> int:
        if Quirk.ERROR_HISTORY_ABORTS in self._quirks and position >= len(self._history):
            raise SdoAbort(AbortCode.NO_DATA)
        return self._history[position] if position < len(self._history) else 0

    def _clear_errors(self, value: Any) -> DelayedWrite | None:
        self._history = []
        return None

    def _error_state_changed(self, state: ErrorState) -> None:
        """Reacts to a change of the error state of the CAN controller."""
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
        if bitrate not in (self.specification.node.bitrates or lss.BITRATES.values()):
            return False
        self._pending_rate = bitrate
        return True

    def _store_lss(self, on_stored: Callable[[int], None]) -> None:
        pending = {
            simulated_device.NODE_ID: self._pending_id,
            simulated_device.BITRATE: self._pending_rate,
        }
        self.store(pending, lambda: on_stored(0))

    def _lss_left(self) -> None:
        """Reacts when the device leaves the LSS state CONFIGURATION.

        A device without a node id applies the pending node id immediately (CiA 305).  A device
        with a node id applies a pending node id at the next reset.
        """
        if self.node_id == lss.UNCONFIGURED and self._pending_id != lss.UNCONFIGURED:
            self.reset_communication()

    def _activate_rate(self, delay: float) -> None:
        """Changes to the pending bitrate as CiA 305 defines.

        The device sends nothing for the time ``delay`` (s), then changes the bitrate, and then
        sends nothing for the time ``delay`` again.
        """
        self.controller.listen_only = True

        def change() -> None:
            self.controller.bitrate = self._pending_rate
            self.controller.restart()
            self.after(delay, end_silence)

        def end_silence() -> None:
            self.controller.listen_only = False

        self.after(delay, change)
