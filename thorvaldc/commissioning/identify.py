"""Compares the devices on a bus with the files of several robots, to find the file of this robot.

One survey of the bus serves all files: the devices are asked once, and each file is compared with
the answers.  Files that match in more serial numbers come first, then those with fewer differences.

A request to a CANopen node can be a command for a drive with another protocol.  If one of the files
has such a drive on a bus with this bitrate, the survey only listens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from thorvaldc.can.canopen import HEARTBEAT, HIGHEST_NODE_ID
from thorvaldc.can.frame import CanInterface
from thorvaldc.commissioning import scan_result
from thorvaldc.commissioning.bus_configuration import (
    BusConfiguration,
    NodeConfiguration,
    configuration_of,
)
from thorvaldc.commissioning.bus_master import BusMaster, Timing
from thorvaldc.commissioning.scan_result import FoundDevice, ScanEntry, identity_text
from thorvaldc.commissioning.scanner import Progress, Scanner
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model import Bus, Robot


@dataclass(frozen=True, slots=True)
class Candidate:
    """A bus of a robot file that may be the one on which the devices answer.

    - ``file``: path of the robot file, as the user named it.
    """

    file: str
    robot: Robot
    bus: Bus

    @property
    def name(self) -> str:
        """The file, with the name of the bus if the robot has several."""
        return self.file if len(self.robot.buses) == 1 else f"{self.file} ({self.bus.name})"


@dataclass(frozen=True, slots=True)
class Difference:
    """A difference between a robot file and the bus.

    - ``node``: name of the node, empty for a device that the file does not name;
    - ``text``: what differs, for a mechanic;
    - ``change``: what to change in the file or on the robot, or empty.
    """

    node: str
    text: str
    change: str = ""


@dataclass(frozen=True, slots=True)
class Match:
    """How well a robot file fits the devices on the bus.

    - ``nodes``: number of nodes in the file;
    - ``ok``: number of nodes that answer as in the file;
    - ``serials``: number of nodes whose serial number answers, at any id.
    """

    candidate: Candidate
    nodes: int
    ok: int
    serials: int
    differences: tuple[Difference, ...]

    @property
    def rank(self) -> tuple[int, int, int]:
        """Files with lower ranks fit better."""
        return -self.serials, len(self.differences), -self.ok

    def as_json(self) -> dict[str, Any]:
        return {
            "file": self.candidate.file,
            "robot": self.candidate.robot.name,
            "bus": self.candidate.bus.name,
            "nodes": self.nodes,
            "ok": self.ok,
            "serials": self.serials,
            "differences": [
                {"node": d.node, "text": d.text, "change": d.change} for d in self.differences
            ],
        }


def only_listens(candidates: Sequence[Candidate]) -> str:
    """Returns the file and the drive because of which no request is sent, or an empty text."""
    for candidate in candidates:
        for node in candidate.bus.nodes:
            if node.channels and not node.is_canopen:
                return f"{candidate.file} ({node.name}: {node.protocol})"
    return ""


def identify(
    interface: CanInterface,
    candidates: Sequence[Candidate],
    progress: Progress | None = None,
    timing: Timing | None = None,
) -> list[Match]:
    """Returns how well each robot file fits the devices on a bus, the best one first.

    All candidates must have the bitrate of the bus.  Raises the same ``DiagnosticError`` as
    ``Scanner.active``.
    """
    configurations = [configuration_of(c.robot, c.bus) for c in candidates]
    scanner = Scanner(
        BusMaster(interface, _all_frames(candidates), timing), _all_nodes(configurations), progress
    )
    asks = not only_listens(candidates)
    findings = scanner.survey() if asks else scanner.overhear()
    received = scanner.master.received
    matches = []
    for candidate, configuration in zip(candidates, configurations, strict=True):
        names = {node.identity: node.name for node in configuration.nodes if node.identity}
        by_name = {
            names[device.identity]: device
            for device in findings.by_name.values()
            if device.identity in names
        }
        known = {frame.key for frame in candidate.bus.frames}
        evaluation = scan_result.ScanEvaluation(
            configuration, replace(findings, by_name=by_name), received, known
        )
        entries = evaluation.active_entries() if asks else evaluation.passive_entries()
        heartbeats = range(HEARTBEAT, HEARTBEAT + HIGHEST_NODE_ID + 1)  # of entries
        strangers = [] if asks else sorted({*received} - known - {*heartbeats})
        matches.append(_match(candidate, configuration, entries, strangers, findings.by_id))
    return sorted(matches, key=lambda match: match.rank)


def _all_frames(candidates: Sequence[Candidate]) -> Bus:
    """Returns a bus with the frames of all files: no request has the identifier of one of them."""
    frames = {frame.key: frame for c in candidates for frame in c.bus.frames}
    return replace(candidates[0].bus, nodes=(), frames=tuple(frames.values()))


def _all_nodes(configurations: Sequence[BusConfiguration]) -> BusConfiguration:
    """Returns a configuration with the nodes of all files, each identity once.

    A node id has its shortest heartbeat period in all files: a node of one file that sends more
    often than that of another is no evidence of two nodes with one id.
    """
    nodes: dict[object, NodeConfiguration] = {}
    periods: dict[int, float] = {}
    for number, configuration in enumerate(configurations):
        for node in configuration.nodes:
            nodes.setdefault(node.identity or (number, node.name), node)
            if node.heartbeat:
                periods[node.id] = min(node.heartbeat, periods.get(node.id, node.heartbeat))
    unique = tuple(
        replace(node, name=str(number), heartbeat=periods.get(node.id))
        for number, node in enumerate(nodes.values())
    )
    return replace(configurations[0], nodes=unique)


def _match(
    candidate: Candidate,
    configuration: BusConfiguration,
    entries: Sequence[ScanEntry],
    strangers: Sequence[int],
    by_id: Mapping[int, FoundDevice],
) -> Match:
    ok = [entry for entry in entries if entry.node and entry.verdict == scan_result.OK]
    serials = [
        entry
        for entry in entries
        if entry.node
        and entry.identity is not None
        and configuration.node(entry.node).serial == entry.identity.serial
    ]
    places = {node.name: f"{node.span.file}:{node.span.line}" for node in candidate.bus.nodes}
    # A device at the id of a node belongs to the difference of that node.
    described = {e.wanted_id for e in entries if e.node and e.verdict == scan_result.WRONG_IDENTITY}
    differences = [
        _difference(entry, configuration, by_id, places)
        for entry in entries
        if entry.verdict != scan_result.OK and (entry.node or entry.device_id not in described)
    ]
    differences += [
        Difference("", f"frames with the identifier {identifier:#05x} are not in the file")
        for identifier in strangers
    ]
    return Match(candidate, len(configuration.nodes), len(ok), len(serials), tuple(differences))


# -- differences in words --------------------------------------------------------------------------


def _difference(
    entry: ScanEntry,
    configuration: BusConfiguration,
    by_id: Mapping[int, FoundDevice],
    places: Mapping[str, str],
) -> Difference:
    if not entry.node:
        return Difference("", entry.detail + _described(entry.device))
    node = configuration.node(entry.node)
    if entry.verdict == scan_result.MISSING:
        text = f"{node.name} (id {node.id}) does not answer"
        return Difference(node.name, text, "look at its plugs and its power")
    if entry.verdict == scan_result.DUPLICATE:
        text = f"two devices have the id {node.id}: {entry.detail}"
        return Difference(node.name, text, "plug in one of them at a time, and flash")
    device = entry.device
    at_id = None if entry.device_id == node.id else by_id.get(node.id)
    if device is not None and device.id != node.id:
        serial = _serial(node.serial)
        text = f"{node.name} (serial number {serial}) has {device.id_text}, not {node.id}"
        return Difference(node.name, text, FLASH)
    if at_id is None or at_id.identity is None:
        return Difference(node.name, f"{node.name}: {entry.detail}")
    actual = at_id.identity
    serials = {n.serial: n.name for n in configuration.nodes if n.serial}
    if actual.serial in serials:  # the difference of its owner says what to change
        text = f"{node.name} does not answer; at its id {node.id} is {serials[actual.serial]}"
        return Difference(node.name, text)
    if (node.vendor, node.product) in ((None, None), (actual.vendor, actual.product)):
        text = f"at the id {node.id} of {node.name} is another device of its type"
        serial = f'`serial: "{_serial(actual.serial)}"`'
        change = f"if {node.name} was replaced, write {serial} at {places[node.name]}"
        return Difference(node.name, f"{text}{_described(at_id)}", change)
    text = f"at the id {node.id} of {node.name} is a device of another type{_described(at_id)}"
    return Difference(node.name, text, "look at what is plugged in there")


FLASH = "`thorvaldc can flash` gives it the id of the file"


def _serial(number: int | None) -> str:
    return "unknown" if number is None else f"{number:#x}"


def _described(device: FoundDevice | None) -> str:
    if device is None or device.identity is None:
        return ""
    return f" ({identity_text(device.identity)})"


# -- as text ---------------------------------------------------------------------------------------


def match_table(matches: Sequence[Match], width: int | None = None) -> str:
    """Returns a text table with one row for each robot file, the best one first.

    ``width``: number of columns of the terminal, or ``None`` for one line per row.
    """
    rows = [("file", "robot", "nodes", "serial numbers", "differences")]
    rows += [
        (
            match.candidate.name,
            match.candidate.robot.name,
            f"{match.ok} of {match.nodes}",
            str(match.serials),
            str(len(match.differences)) if match.differences else "none",
        )
        for match in matches
    ]
    return text_table(rows, width)


def verdict(matches: Sequence[Match]) -> str:
    """Returns one sentence: which file is that of the robot on the bus."""
    best = matches[0]
    if not best.ok and not best.serials:
        return "none of the files is that of the robot on this bus"
    equal = [match.candidate.name for match in matches if match.rank == best.rank]
    if len(equal) > 1:
        return f"these files match equally: {', '.join(equal)}"
    if not best.differences:
        return f"this is {best.candidate.robot.name}: {best.candidate.name}"
    count = len(best.differences)
    differences = f"{count} difference{'s' * (count > 1)}"
    return f"this is most likely {best.candidate.robot.name}: {best.candidate.name}, {differences}"
