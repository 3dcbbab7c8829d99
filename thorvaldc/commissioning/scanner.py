"""Scans a bus for CANopen nodes.

A passive scan only receives CAN frames.  An active scan first receives CAN frames, and then sends
requests to one node after another.  Two nodes with the same node id cause no error on the bus.  To
detect two nodes with the same id, the scanner counts all responses and reads the serial numbers
twice.  The scanner never sends frames to test a bitrate.

Sequence of an active scan:

    listen       > 3 heartbeat periods      rate of heartbeats, boot-ups, another master
    discover     0x601, 0x602, ... 0x67E    one upload of 0x1000 each, 4 ms apart
    identify     each responding node       0x1000, 0x1018:1..4 (serial number twice), texts
    LSS select   each known identity        number of responses, id of the device
    LSS fastscan                            devices without id that no serial number found
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from thorvaldc.can.canopen import HEARTBEAT, SDO_REQUEST, SDO_RESPONSE, DriveState, NmtState
from thorvaldc.can.frame import CanInterface
from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.can.sdo import upload_request
from thorvaldc.commissioning import bus_master, scan_result
from thorvaldc.commissioning.bus_configuration import (
    BusConfiguration,
    NodeConfiguration,
    configuration_of,
)
from thorvaldc.commissioning.lss_master import LssError, LssMaster
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Node, Robot
from thorvaldc.model.bus_identity import SERIAL_NUMBER

PERIODS = 3.2
"""Listening time in periods of the slowest heartbeat.

In this time one node sends at most 4 heartbeats, and two nodes with the same id send at least 6."""
SHORTEST_LISTENING = 0.3
"""Shortest listening time (s)."""
BACKLOG = 0.02
"""Time (s) at the start of listening in which the heartbeats of a node count as one.

A node that was alone on the bus now sends all frames that were not acknowledged before."""
SERIAL_ROUNDS = 2
"""Number of times that each serial number is read."""
IDENTITY, DEVICE_TYPE = 0x1018, 0x1000
TEXTS = (0x1008, 0x1009, 0x100A)
"""Indices of the objects for device name, hardware version and software version."""
SURPLUS = "more answers than requests"
LAST_SCANNED_ID = 126
"""Highest scanned node id; node id 127 belongs to the master."""
PROGRESS_STEP = 8

Progress = Callable[[str, int, int], None]
"""Called with the name of the activity, the number of finished parts, and the number of parts."""


class Scanner:
    """Scanner that compares the devices on a bus with the required configuration."""

    def __init__(
        self,
        master: bus_master.BusMaster,
        configuration: BusConfiguration,
        progress: Progress | None = None,
    ) -> None:
        self.master = master
        self.configuration = configuration
        self.sdo = bus_master.SdoClient(master)
        self.lss = LssMaster(master)
        self._progress = progress or (lambda activity, completed, total: None)
        self._findings = scan_result.Findings()

    def passive(self) -> scan_result.ScanResult:
        """Scans the CAN bus without sending frames."""
        self._listen()
        return self._result(False, self._evaluation().passive_entries())

    def active(self, *, values: bool = True, texts: bool = True) -> scan_result.ScanResult:
        """Scans the CAN bus by receiving frames and by sending requests to every node id.

        If ``values`` is ``True``, the scan also reads the object values that the required
        configuration contains.  If ``texts`` is ``True``, the scan also reads the device names,
        hardware versions and software versions.  Raises ``DiagnosticError`` (``bus-other-master``)
        if another master is on the bus, and ``bus-not-canopen`` if none of its motor controllers is
        a CANopen node.
        """
        self.survey(texts=texts)
        return self._evaluate(values)

    def overhear(self) -> scan_result.Findings:
        """Receives frames without sending any, and returns the suspected duplicates."""
        self._listen()
        return self._findings

    def survey(self, *, texts: bool = False) -> scan_result.Findings:
        """Receives frames, asks every node id, and returns the devices that have answered.

        Raises the same ``DiagnosticError`` as ``active``.
        """
        self._require_canopen()
        self._listen()
        if self.master.masters:
            raise bus_master.other_master_error(list(self.master.masters))
        self._discover()
        self._identify(texts)
        nodes = [node for node in self.configuration.nodes if node.lss]
        self._select([(node.name, node.identity) for node in nodes if node.identity is not None])
        if nodes:
            self._find_devices_without_id()
        self._add_surplus()
        return self._findings

    def _require_canopen(self) -> None:
        """Raises an error before any frame is sent to motor controllers with another protocol.

        On their bus the identifiers of CANopen have another meaning: an SDO request to node 13 is a
        velocity command to the node 48 of CANSimple.
        """
        nodes = self.configuration.nodes
        others = [node for node in nodes if node.drive and not node.canopen]
        if others and not any(node.canopen for node in nodes):
            names = ", ".join(f"{node.name} ({node.protocol})" for node in others)
            raise DiagnosticError(
                "bus-not-canopen",
                f"no node of the bus `{self.configuration.bus}` is a CANopen node, so no frame was "
                f"sent: {names}",
                hint="set ids and settings with the tool of the manufacturer; `can scan` without "
                "--active and `can monitor` show the frames of the nodes",
            )

    def again(self, previous: scan_result.ScanResult) -> scan_result.ScanResult:
        """Scans again the devices in the scan result ``previous``, after a reset of the nodes."""
        findings = self._findings
        findings.evidence = dict(previous.duplicates)
        lss_nodes = {node.name for node in self.configuration.nodes if node.lss}
        identities = [
            (entry.node, entry.identity)
            for entry in previous.entries
            if entry.node in lss_nodes and entry.identity is not None
        ]
        self._select(identities)
        ids = {device.id for device in findings.by_name.values()}
        for entry in previous.entries:
            device = entry.device
            if device is None or device.id is None or entry.node in findings.by_name:
                continue
            if device.id == UNCONFIGURED:
                if not entry.node:
                    findings.without_id.append(device)
            elif not entry.node or self.configuration.node(entry.node).sdo:
                ids.add(device.id)
        for node in sorted(i for i in ids if i is not None and i != UNCONFIGURED):
            self._probe(node, self.master.timing.lss)
        self._identify(texts=False)
        return self._evaluate(values=True)

    # -- phases of a scan -------------------------------------------------------------------

    def _listen(self) -> None:
        nodes = self.configuration.nodes
        periods = [node.heartbeat for node in nodes if node.heartbeat]
        seconds = max([PERIODS * period for period in periods] + [SHORTEST_LISTENING])
        self.master.forget()
        self._progress("listening", 0, 1)
        self.master.listen(BACKLOG)
        waited = {node.id: len(self._heartbeats(node.id)) for node in nodes}
        self.master.listen(seconds - BACKLOG)
        self._progress("listening", 1, 1)
        evidence = self._findings.evidence
        for node in nodes:
            count = len(self._heartbeats(node.id)) - max(waited[node.id] - 1, 0)
            if node.canopen and node.heartbeat and count > seconds / node.heartbeat + 1.5:
                evidence[node.id] = (
                    f"{count} heartbeats in {seconds:g} s; the period is {node.heartbeat:g} s"
                )
        for node_id in sorted(set(self.master.boots)):
            if self.master.boots.count(node_id) > 1:
                evidence[node_id] = f"{self.master.boots.count(node_id)} boot-ups"

    def _discover(self) -> None:
        """Sends one SDO request to every possible node id, and counts the responses."""
        used = {frame.key for frame in self.master.bus.frames if frame.kind != "sdo"}
        without_sdo = {n.id for n in self.configuration.nodes if n.canopen and not n.sdo}
        without_sdo.add(self.master.bus.master_id)
        ids = [
            node
            for node in range(1, LAST_SCANNED_ID + 1)
            if node not in without_sdo and SDO_REQUEST + node not in used
        ]
        earlier = {node: len(self._responses(node)) for node in ids}
        for position, node in enumerate(ids):
            if position % PROGRESS_STEP == 0:
                self._progress("looking for nodes", position, len(ids))
            self.master.send(SDO_REQUEST + node, upload_request(DEVICE_TYPE, 0))
            self.master.listen(self.master.timing.probe_gap)
        self.master.listen(self.master.timing.probe_tail)
        self._progress("looking for nodes", len(ids), len(ids))
        for node in ids:
            self._add_responding(node, len(self._responses(node)) - earlier[node])

    def _heartbeats(self, node: int) -> list[float]:
        return self.master.received.get(HEARTBEAT + node, [])

    def _responses(self, node: int) -> list[float]:
        return self.master.received.get(SDO_RESPONSE + node, [])

    def _probe(self, node: int, timeout: float) -> None:
        responses = self.sdo.upload_all(node, DEVICE_TYPE, 0, timeout=timeout)
        self._add_responding(node, len(responses))

    def _add_responding(self, node: int, responses: int) -> None:
        if responses:
            self._findings.by_id[node] = scan_result.FoundDevice(node)
        if responses > 1:
            self._findings.evidence[node] = f"{responses} answers to one request"

    def _identify(self, texts: bool) -> None:
        by_id = self._findings.by_id
        ids = sorted(node for node in by_id if by_id[node].identity is None)
        for position, node in enumerate(ids):
            self._progress("reading identities", position, len(ids))
            device_type = (self._read_all(node, DEVICE_TYPE, 0, 1) or [None])[-1]
            numbers = [
                self._read_all(node, IDENTITY, subindex, SERIAL_ROUNDS if subindex == 4 else 1)
                for subindex in (1, 2, 3, 4)
            ]
            # A number of the identity is 0 if the node refuses to report the number.  The identity
            # of a node is unknown if the node does not respond.
            complete = all(numbers) and numbers[0][-1] is not None
            identity = Identity(*(answers[-1] or 0 for answers in numbers)) if complete else None
            read_texts: tuple[str, ...] = ()
            if texts and node not in self._findings.evidence:
                read_texts = tuple(self._read_text(node, index) for index in TEXTS)
            by_id[node] = scan_result.FoundDevice(node, identity, device_type, read_texts)
        self._progress("reading identities", len(ids), len(ids))

    def _read_all(self, node: int, index: int, subindex: int, rounds: int) -> list[int | None]:
        """Reads an object that is a number ``rounds`` times by SDO, and returns the numbers in all
        responses.

        The returned number is ``None`` if the node refuses the SDO request.
        """
        evidence = self._findings.evidence
        numbers: list[int | None] = []
        for _ in range(rounds):
            timeout = self.master.timing.sdo
            responses = self.sdo.upload_all(node, index, subindex, timeout=timeout)
            if len(responses) > 1:
                evidence[node] = f"{len(responses)} answers to one request"
            for response in responses:
                value = int.from_bytes(response.data, "little")
                numbers.append(None if response.abort is not None else value)
        if any(number != numbers[0] for number in numbers):
            evidence[node] = "its identity changes from answer to answer"
        return numbers

    def _read_text(self, node: int, index: int) -> str:
        try:
            return self.sdo.read_text(node, index)
        except bus_master.SdoMultipleResponses as error:
            self._findings.evidence[node] = str(error)
        except bus_master.SdoError:
            pass
        return ""

    def _select(self, identities: Sequence[tuple[str, Identity]]) -> None:
        """Reads the node ids of the devices with the given identities by LSS."""
        for position, (name, identity) in enumerate(identities):
            self._progress("selecting by serial number", position, len(identities))
            self.lss.switch_to_waiting()
            count = self.lss.select(identity)
            if count == 0:
                continue
            if count > 1:
                node_id = self.configuration.node(name).id
                self._findings.evidence[node_id] = (
                    f"{count} devices have the identity {scan_result.identity_text(identity)}"
                )
                continue
            try:
                self._findings.by_name[name] = scan_result.FoundDevice(self.lss.node_id(), identity)
            except LssError:
                continue  # a device that does not respond correctly is ignored
        if identities:
            self._progress("selecting by serial number", len(identities), len(identities))
            self.lss.switch_to_waiting()

    def _find_devices_without_id(self) -> None:
        """Finds devices without node id and with unknown serial numbers by LSS fastscan."""
        self.lss.switch_to_waiting()
        if not self.lss.has_unconfigured_slave():
            return
        selected = self._findings.by_name
        known = [
            device.identity
            for device in selected.values()
            if device.id == UNCONFIGURED and device.identity is not None
        ]
        if known and all(node.name in selected for node in self.configuration.nodes if node.lss):
            return  # the slaves that respond are these devices, and no node is missing
        self._progress("looking for devices without id", 0, 1)
        try:
            identities: Sequence[Identity | None] = self.lss.find_without_id(known)
        except LssError:
            identities = [None]  # a device without id is there, and its identity is unknown
        without_id = self._findings.without_id
        without_id += [scan_result.FoundDevice(UNCONFIGURED, identity) for identity in identities]
        self._progress("looking for devices without id", 1, 1)

    # -- result -----------------------------------------------------------------------------

    def _evaluation(self) -> scan_result.ScanEvaluation:
        known = {frame.key for frame in self.master.bus.frames}
        return scan_result.ScanEvaluation(
            self.configuration, self._findings, self.master.received, known
        )

    def _add_surplus(self) -> None:
        """Suspects two nodes with one id where more SDO responses arrived than were requested."""
        for node_id in self.master.surplus:
            self._findings.evidence.setdefault(node_id, SURPLUS)

    def _evaluate(self, values: bool) -> scan_result.ScanResult:
        self._add_surplus()
        entries = self._evaluation().active_entries()
        read: dict[str, dict[tuple[int, int], int | None]] = {}
        if values:
            readable = [
                entry for entry in entries if entry.node and entry.verdict == scan_result.OK
            ]
            for position, entry in enumerate(readable):
                self._progress("reading values", position, len(readable))
                node = self.configuration.node(entry.node)
                if node.sdo and node.values and node.id != UNCONFIGURED:
                    read[node.name] = self.sdo.read_values(
                        node.id, node.values, bus_master.SdoError
                    )
            self._progress("reading values", len(readable), len(readable))
        return self._result(True, entries, read)

    def _result(
        self,
        active: bool,
        entries: Sequence[scan_result.ScanEntry],
        values: dict[str, dict[tuple[int, int], int | None]] | None = None,
    ) -> scan_result.ScanResult:
        enabled: list[tuple[str, str]] = []
        for entry in entries:
            node = self.configuration.node(entry.node) if entry.node else None
            node_id = entry.device_id
            if node is None or not node.drive or node_id is None or node_id == UNCONFIGURED:
                continue
            if self.master.states.get(node_id) == NmtState.OPERATIONAL:
                enabled.append((node.name, "it is operational"))
            elif active and entry.verdict in (
                scan_result.OK,
                scan_result.WRONG_IDENTITY,
                scan_result.WITHOUT_ID,
            ):
                enabled += [(node.name, reason) for reason in self._enabled(node, node_id)]
        self._add_surplus()  # those that arrived while values were read
        return scan_result.ScanResult(
            active,
            tuple(entries),
            tuple(self.master.masters),
            tuple(enabled),
            tuple(sorted(self._findings.evidence.items())),
            values or {},
            self.master.frames,
        )

    def _enabled(self, node: NodeConfiguration, node_id: int) -> list[str]:
        """Returns a message for each status word that reports an enabled motor of the node."""
        reasons = []
        for index in node.statuswords:
            try:
                word = self.sdo.read_number(node_id, index, 0, "unsigned16")
            except bus_master.SdoError:
                continue
            state = DriveState.of(word)
            if state in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE):
                reasons.append(f"its statusword {index:04x} is {word:#06x}, enabled")
        return reasons


def scan_robot(robot: Robot, interfaces: Mapping[str, CanInterface]) -> list[scan_result.ScanEntry]:
    """Returns the devices on all buses of a robot, without their values.

    - ``interfaces``: CAN interface of each bus, by the name of the bus.

    Raises ``DiagnosticError`` (``bus-other-master``) if another master is on a bus.  A request to a
    CANopen node can be a command for a drive with another protocol: a bus with such a drive is only
    listened to.
    """
    scans = [scan_bus(robot, bus_master.BusMaster(interfaces[b.name], b)) for b in robot.buses]
    return [entry for scan in scans for entry in scan.entries]


def scan_bus(robot: Robot, master: bus_master.BusMaster) -> scan_result.ScanResult:
    """Returns the devices on a bus of a robot, as ``scan_robot`` does."""
    scanner = Scanner(master, configuration_of(robot, master.bus))
    asks = all(node.is_canopen for node in master.bus.nodes if node.channels)
    scan = scanner.active(values=False, texts=False) if asks else scanner.passive()
    if scan.masters:
        raise bus_master.other_master_error(list(scan.masters))
    return scan


def with_serial_numbers(robot: Robot, devices: Sequence[scan_result.ScanEntry]) -> Robot:
    """Returns the robot with the serial numbers of its devices.

    The base then compares them at each start-up, also after a device was replaced.
    """
    serials = {e.node: e.identity.serial for e in devices if e.identity and e.identity.serial}

    def stated(node: Node) -> Node:
        objects = tuple(
            replace(o, value=serials.get(node.name, o.value))
            if (o.index, o.subindex) == SERIAL_NUMBER
            else o
            for o in node.objects
        )
        return replace(node, objects=objects)

    buses = tuple(replace(bus, nodes=tuple(map(stated, bus.nodes))) for bus in robot.buses)
    return replace(robot, buses=buses)
