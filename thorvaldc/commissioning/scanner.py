"""What is on a bus: first by listening, then, if asked, by asking one node at a time.

Duplicate addresses do not announce themselves, so every answer is counted, again and again.
Bitrates are never probed by sending.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import BusConfiguration, NodeConfiguration
from thorvaldc.commissioning.bus_master import (
    HEARTBEAT,
    OPERATIONAL,
    SDO_REQUEST,
    SDO_RESPONSE,
    BusMaster,
    other_master_error,
)
from thorvaldc.commissioning.lss_master import LssError, LssMaster
from thorvaldc.commissioning.scan_result import (
    DUPLICATE,
    MISSING,
    OK,
    UNEXPECTED,
    WITHOUT_ID,
    WRONG_IDENTITY,
    FoundDevice,
    ScanEntry,
    ScanResult,
    identity_text,
)
from thorvaldc.commissioning.sdo_client import (
    SdoAborted,
    SdoClient,
    SdoMultipleResponses,
    SdoTimeout,
)

PERIODS = 3.2
"""Periods of the slowest heartbeat to listen for: one node is heard at most four times, two
nodes of one id at least six times."""
LEAST_LISTENING = 0.3
BACKLOG = 0.02
"""s in which a node that was alone, and had nobody to acknowledge its frames, sends those that
waited: heartbeats of this time count as one."""
ROUNDS = 2
"""How often an identity is read."""
IDENTITY, DEVICE_TYPE = 0x1018, 0x1000
SURPLUS = "more answers than requests"
TEXTS = (0x1008, 0x1009, 0x100A)

Progress = Callable[[str, int, int], None]
"""Progress: what is being done, how many of how many are done."""


class Scanner:
    """Finds what is on the bus and compares it with the target."""

    def __init__(
        self, master: BusMaster, target: BusConfiguration, progress: Progress | None = None
    ) -> None:
        self.master = master
        self.target = target
        self.sdo = SdoClient(master)
        self.lss = LssMaster(master)
        self._progress = progress or (lambda what, done, of: None)
        self._evidence: dict[int, str] = {}
        self._found: dict[int, FoundDevice] = {}  # by id, as SDO tells
        self._placed: dict[str, FoundDevice] = {}  # by the node's name, as LSS tells
        self._bare: list[FoundDevice] = []

    def passive(self) -> ScanResult:
        """Listen for two periods of the heartbeats; nothing is sent."""
        self._listen()
        entries = []
        for node in self.target.nodes:
            heard = self._heard_of(node)
            doubt = self._evidence.get(node.id) if node.canopen else None
            if doubt:
                entries.append(
                    ScanEntry(node.name, DUPLICATE, node.id, FoundDevice(node.id), doubt)
                )
            elif heard:
                detail = "heard; its identity was not asked for" if node.sdo else "heard"
                entries.append(ScanEntry(node.name, OK, node.id, FoundDevice(node.id), detail))
            else:
                detail = "not heard; it may be there without sending by itself"
                entries.append(ScanEntry(node.name, MISSING, node.id, None, detail))
        entries += self._strangers()
        return self._scan(False, entries)

    def active(self, *, values: bool = True, texts: bool = True) -> ScanResult:
        """Listen, then ask every node.  ``values``: read the objects that the target names, too.

        Raises ``DiagnosticError`` (``bus-other-master``) where another asks already.
        """
        self._listen()
        if self.master.masters:
            raise other_master_error(list(self.master.masters))
        self._discover()
        self._identify(texts)
        nodes = [node for node in self.target.nodes if node.lss]
        self._select([(n.name, n.identity) for n in nodes if n.identity is not None])
        if nodes:
            self._look_for_bare()
        return self._judge(values)

    def again(self, before: ScanResult, *, values: bool = True) -> ScanResult:
        """Ask only those whom ``before`` has found, and LSS by serial number: nobody is looked for.

        For just after a reset of the robot's own nodes.
        """
        self._evidence = dict(before.duplicates)
        lss = {node.name for node in self.target.nodes if node.lss}
        known = [
            (e.node, e.found.identity)
            for e in before.entries
            if e.node in lss and e.found is not None and e.found.identity is not None
        ]
        self._select(known)
        ids = {found.id for found in self._placed.values()}
        for entry in before.entries:
            found = entry.found
            if found is None or found.id is None or entry.node in self._placed:
                continue
            if found.id == UNCONFIGURED:
                if not entry.node:
                    self._bare.append(found)
            elif not entry.node or self.target.node(entry.node).sdo:
                ids.add(found.id)
        for node in sorted(i for i in ids if i is not None and i != UNCONFIGURED):
            self._probe(node, self.master.timing.lss)
        self._identify(texts=False)
        return self._judge(values)

    # -- steps of a scan --------------------------------------------------------------------

    def _listen(self) -> None:
        periods = [n.heartbeat for n in self.target.nodes if n.heartbeat]
        seconds = max([PERIODS * period for period in periods] + [LEAST_LISTENING])
        self.master.forget()
        self._progress("listening", 0, 1)
        self.master.listen(BACKLOG)
        waited = {node.id: len(self._heartbeats(node.id)) for node in self.target.nodes}
        self.master.listen(seconds - BACKLOG)
        self._progress("listening", 1, 1)
        for node in self.target.nodes:
            count = len(self._heartbeats(node.id)) - max(waited[node.id] - 1, 0)
            if node.canopen and node.heartbeat and count > seconds / node.heartbeat + 1.5:
                self._evidence[node.id] = (
                    f"{count} heartbeats in {seconds:g} s, one each {node.heartbeat:g} s is right"
                )
        for where in sorted(set(self.master.boots)):
            if self.master.boots.count(where) > 1:
                self._evidence[where] = f"{self.master.boots.count(where)} boot-ups"

    def _discover(self) -> None:
        """One small request to every id that may be a node's; who answers is asked more."""
        taken = {frame.cob_id for frame in self.master.bus.frames if frame.kind != "sdo"}
        silent = {n.id for n in self.target.nodes if n.canopen and not n.sdo}
        silent.add(self.master.bus.master_id)
        ids = [n for n in range(1, 127) if n not in silent and SDO_REQUEST + n not in taken]
        before = {n: len(self._answers(n)) for n in ids}
        for place, node in enumerate(ids):
            if place % 8 == 0:
                self._progress("looking for nodes", place, len(ids))
            self.master.send(SDO_REQUEST + node, bytes([0x40, 0x00, 0x10, 0, 0, 0, 0, 0]))
            self.master.listen(self.master.timing.probe_gap)
        self.master.listen(self.master.timing.probe_tail)
        self._progress("looking for nodes", len(ids), len(ids))
        for node in ids:
            count = len(self._answers(node)) - before[node]
            if count:
                self._found[node] = FoundDevice(node)
            if count > 1:
                self._evidence[node] = f"{count} answers to one request"

    def _heartbeats(self, node: int) -> list[float]:
        return self.master.heard.get(HEARTBEAT + node, [])

    def _answers(self, node: int) -> list[float]:
        return self.master.heard.get(SDO_RESPONSE + node, [])

    def _probe(self, node: int, timeout: float) -> None:
        answers = self.sdo.every(node, DEVICE_TYPE, 0, timeout=timeout)
        if answers:
            self._found[node] = FoundDevice(node)
        if len(answers) > 1:
            self._evidence[node] = f"{len(answers)} answers to one request"

    def _identify(self, texts: bool) -> None:
        ids = sorted(n for n in self._found if self._found[n].identity is None)
        for place, node in enumerate(ids):
            self._progress("reading identities", place, len(ids))
            kind = (self._number(node, DEVICE_TYPE, 0, 1) or [None])[-1]
            numbers = [
                self._number(node, IDENTITY, subindex, ROUNDS if subindex == 4 else 1)
                for subindex in (1, 2, 3, 4)
            ]
            # A number that it refuses it does not have; one that it is silent about is not known.
            known = all(numbers) and numbers[0][-1] is not None
            identity = Identity(*(seen[-1] or 0 for seen in numbers)) if known else None
            words: tuple[str, ...] = ()
            if texts and node not in self._evidence:
                words = tuple(self._text(node, index) for index in TEXTS)
            self._found[node] = FoundDevice(node, identity, kind, words)
        self._progress("reading identities", len(ids), len(ids))

    def _number(self, node: int, index: int, subindex: int, rounds: int) -> list[int | None]:
        """Every answer to requests for a number; ``None``: it was refused."""
        seen: list[int | None] = []
        for _ in range(rounds):
            answers = self.sdo.every(node, index, subindex, timeout=self.master.timing.sdo)
            if len(answers) > 1:
                self._evidence[node] = f"{len(answers)} answers to one request"
            for answer in answers:
                value = int.from_bytes(answer.data, "little")
                seen.append(None if answer.abort is not None else value)
        if any(value != seen[0] for value in seen):
            self._evidence[node] = "its identity changes from answer to answer"
        return seen

    def _text(self, node: int, index: int) -> str:
        try:
            return self.sdo.text(node, index)
        except (SdoAborted, SdoTimeout):
            return ""
        except SdoMultipleResponses as fault:
            self._evidence[node] = str(fault)
            return ""

    def _select(self, known: Sequence[tuple[str, Identity]]) -> None:
        """Where the nodes with these identities are."""
        for place, (name, identity) in enumerate(known):
            self._progress("asking by serial number", place, len(known))
            self.lss.waiting()
            count = self.lss.select(identity)
            if count == 0:
                continue
            if count > 1:
                where = self.target.node(name).id
                self._evidence[where] = f"{count} devices are {identity_text(identity)}"
                continue
            try:
                self._placed[name] = FoundDevice(self.lss.node_id(), identity)
            except LssError:
                continue  # it is gone, or its answers are doubtful: it is not found
        if known:
            self._progress("asking by serial number", len(known), len(known))
            self.lss.waiting()

    def _look_for_bare(self) -> None:
        """Devices without id that no serial number of the file led to."""
        self.lss.waiting()
        if not self.lss.someone_unconfigured():
            return
        for found in self._placed.values():
            # In the configuration state they do not answer the search.
            if found.id == UNCONFIGURED and found.identity is not None:
                self.lss.select(found.identity)
        while len(self._bare) < 126 and (identity := self.lss.fastscan()) is not None:
            self._progress("looking for devices without id", len(self._bare), 0)
            self._bare.append(FoundDevice(UNCONFIGURED, identity))
        self.lss.waiting()

    # -- verdicts ---------------------------------------------------------------------------

    def _judge(self, values: bool) -> ScanResult:
        for where in sorted(self.master.surplus):
            self._evidence.setdefault(where, SURPLUS)
        placed = self._place()
        entries = [self._verdict(node, placed) for node in self.target.nodes]
        taken = list(placed.values())
        for found in (*self._found.values(), *self._bare):
            if any(found is other for other in taken):
                continue
            shared = [e for e in entries if e.found is not None and e.found.id == found.id]
            if found.id in self._evidence and found.id != UNCONFIGURED and shared:
                continue
            if found.identity is not None and any(
                other.identity == found.identity and other.id == found.id for other in taken
            ):
                continue
            what = "no id" if found.id == UNCONFIGURED else f"id {found.id}"
            if found.id in self._evidence:
                detail = self._evidence[found.id]
                entries.append(ScanEntry("", DUPLICATE, None, found, detail))
            else:
                detail = f"a device with {what} that the robot's file does not name"
                if found.identity is None:
                    detail = f"the device with {what} does not say who it is"
                entries.append(ScanEntry("", UNEXPECTED, None, found, detail))
        entries += self._strangers()
        read: dict[str, dict[tuple[int, int], int | None]] = {}
        if values:
            readable = [e for e in entries if e.node and e.verdict == OK]
            for place, entry in enumerate(readable):
                self._progress("reading values", place, len(readable))
                node = self.target.node(entry.node)
                if node.sdo and node.values and node.id != UNCONFIGURED:
                    read[node.name] = self._values(node, node.id)
            self._progress("reading values", len(readable), len(readable))
        return self._scan(True, entries, read)

    def _place(self) -> dict[str, FoundDevice]:
        """The device that is taken for each node."""
        placed: dict[str, FoundDevice] = {}
        for node in self.target.nodes:
            given = self._placed.get(node.name)
            here = self._found.get(node.id) if node.canopen else None
            if given is not None:
                own = None if given.id is None else self._found.get(given.id)
                whole = own is not None and own.identity == given.identity
                placed[node.name] = own if whole and own is not None else given
            elif here is not None and self._alike(node, here):
                placed[node.name] = here
            elif (elsewhere := self._by_serial(node)) is not None:
                placed[node.name] = elsewhere
            elif not node.sdo and self._heard_of(node):
                placed[node.name] = FoundDevice(node.id if node.canopen else None)
        for node in self.target.nodes:
            # Without a serial number in the file the only one of its kind is it.
            if node.name in placed or not node.lss or node.serial is not None:
                continue
            like = [f for f in (*self._bare, *self._found.values()) if self._alike(node, f)]
            free = [f for f in like if not any(f is other for other in placed.values())]
            waiting = [
                other
                for other in self.target.nodes
                if other.name not in placed
                and other.lss
                and other.serial is None
                and free
                and self._alike(other, free[0])
            ]
            if len(free) == 1 and len(waiting) == 1:
                placed[node.name] = free[0]
        return placed

    def _by_serial(self, node: NodeConfiguration) -> FoundDevice | None:
        """One that says over SDO that it is that very device, though it does not by LSS."""
        if node.serial is None:
            return None
        return next((f for f in self._found.values() if self._alike(node, f)), None)

    def _alike(self, node: NodeConfiguration, found: FoundDevice) -> bool:
        if found.identity is None or not node.is_like(found.identity):
            return False
        kind = node.device_type
        return kind is None or found.device_type is None or kind == found.device_type

    def _verdict(self, node: NodeConfiguration, placed: dict[str, FoundDevice]) -> ScanEntry:
        found = placed.get(node.name)
        where = node.id if node.canopen else None
        if found is not None and found.id in self._evidence and found.id is not None:
            return ScanEntry(node.name, DUPLICATE, where, found, self._evidence[found.id])
        if where in self._evidence and where is not None:
            return ScanEntry(node.name, DUPLICATE, where, found, self._evidence[where])
        if found is not None and found.id == where:
            if node.device_type not in (None, found.device_type) and node.sdo:
                kind = "no" if found.device_type is None else f"{found.device_type:#x}"
                detail = f"its device type is {kind}, not {node.device_type:#x}"
                return ScanEntry(node.name, WRONG_IDENTITY, where, found, detail)
            return ScanEntry(node.name, OK, where, found)
        here = self._found.get(node.id) if node.canopen and node.sdo else None
        if here is not None:
            name = identity_text(here.identity)
            detail = f"at id {node.id} stands {name}"
            if found is not None:
                at = "without id" if found.id == UNCONFIGURED else f"at id {found.id}"
                detail += f", it is {at}"
            return ScanEntry(node.name, WRONG_IDENTITY, where, found, detail)
        if found is not None:
            at = "it has no id yet" if found.id == UNCONFIGURED else f"it has the id {found.id}"
            return ScanEntry(node.name, WITHOUT_ID, where, found, at)
        return ScanEntry(node.name, MISSING, where, None, "nobody answers for it")

    def _heard_of(self, node: NodeConfiguration) -> bool:
        return any(identifier in self.master.heard for identifier, _ in node.seen_by)

    def _strangers(self) -> list[ScanEntry]:
        """Ids that only heartbeats tell of, and frames that nobody in the file sends."""
        known = {frame.cob_id for frame in self.master.bus.frames}
        entries = []
        for identifier in sorted(self.master.heard):
            node = identifier - HEARTBEAT
            if identifier in known or not 0 < node < 127:
                continue
            if node not in self._found and all(f.id != node for f in self._placed.values()):
                detail = f"the heartbeat of id {node} is heard, which is not in the robot's file"
                entries.append(ScanEntry("", UNEXPECTED, None, FoundDevice(node), detail))
        return entries

    def _values(self, node: NodeConfiguration, where: int) -> dict[tuple[int, int], int | None]:
        found: dict[tuple[int, int], int | None] = {}
        for value in node.values:
            try:
                found[value.place] = self.sdo.number(where, *value.place, value.type)
            except (SdoAborted, SdoTimeout, SdoMultipleResponses):
                found[value.place] = None
        return found

    def _scan(
        self,
        active: bool,
        entries: Sequence[ScanEntry],
        values: dict[str, dict[tuple[int, int], int | None]] | None = None,
    ) -> ScanResult:
        enabled: list[tuple[str, str]] = []
        for entry in entries:
            node = self.target.node(entry.node) if entry.node else None
            where = entry.found.id if entry.found is not None else None
            if node is None or not node.drive or where is None or where == UNCONFIGURED:
                continue
            if self.master.states.get(where) == OPERATIONAL:
                enabled.append((node.name, "it is operational"))
            elif active and entry.verdict in (OK, WRONG_IDENTITY, WITHOUT_ID):
                enabled += [(node.name, word) for word in self._enabled(node, where)]
        # Of what came while values were read, after the verdicts.
        late = [(where, SURPLUS) for where in sorted(self.master.surplus)]
        late = [pair for pair in late if pair[0] not in self._evidence]
        return ScanResult(
            active,
            tuple(entries),
            tuple(self.master.masters),
            tuple(enabled),
            (*sorted(self._evidence.items()), *late),
            values or {},
            self.master.frames,
        )

    def _enabled(self, node: NodeConfiguration, where: int) -> list[str]:
        """Where a drive says that its motor is under current."""
        found = []
        for index in node.statuswords:
            try:
                word = self.sdo.number(where, index, 0, "unsigned16")
            except (SdoAborted, SdoTimeout, SdoMultipleResponses):
                continue
            if word & 0x6F in (0x27, 0x07):
                found.append(f"its statusword {index:04x} is {word:#06x}, enabled")
        return found
