"""Checks what a module states of a CANopen device against the EDS file of its manufacturer.

The key `eds` in the section `can` of a module document names the file, which stands beside the
module document; ``dictionary_of`` reads it.  ``check_against_eds`` reports what the device would
refuse or report otherwise: values that `thorvaldc can flash` and the generated files write, the
identity, and the objects in PDOs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from thorvaldc.compiler.bus.device_sections import (
    EVENT_TIMER,
    IDENTITY,
    RPDO,
    SYNC_COB_ID,
    TPDO,
    Device,
)
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import FrameDefinition, Node, ObjectValue
from thorvaldc.model.bus import MASTER, OBJECT_TYPES

if TYPE_CHECKING:
    from thorvaldc.compiler.bus.device_file import Dictionary, Entry

SUFFIXES = ("eds", "dcf")
_END_OF_PDOS = 0x1C00
_DUMMIES = 0x20
"""Objects below this index are types; in an RPDO they stand for bits without use (CiA 301)."""
_COMMAND_ACCESS, _REPORT_ACCESS = ("rw", "rww", "wo"), ("rw", "rwr", "ro", "const")
_SERIAL_NUMBER = (IDENTITY, 4)
_CORRECT = "correct the module; or the EDS, if the manual of the device says otherwise"


def dictionary_of(device: Device, report: Report) -> Dictionary | None:
    """Returns the object dictionary in the EDS file of a device, or ``None`` if there is none.

    Reports why a file cannot be read.
    """
    named, module = device.can.get("eds"), device.scope.module
    if named is None or module is None:
        return None
    # Only a robot with an EDS file loads the module that starts worker processes.
    from thorvaldc.compiler.bus.device_file import read_eds

    file = device.scope.library.file_beside(module, named, SUFFIXES, report)
    return None if file is None else read_eds(*file, report)


def check_against_eds(
    device: Device,
    node: Node,
    frames: Sequence[FrameDefinition],
    objects: Sequence[tuple[ObjectValue, Span]],
    dictionary: Dictionary,
    report: Report,
) -> Sequence[tuple[ObjectValue, Span]]:
    """Reports contradictions between a module and the EDS file that it names.

    Returns the objects without the event timers that are off and that the device does not have.

    - ``node``, ``frames``: node of the device in the model, and its frames.
    - ``objects``: entries of the object dictionary as ``objects_of`` returns them.
    - ``dictionary``: what the EDS file states, as ``dictionary_of`` returns it.
    """
    objects = [(o, span) for o, span in objects if not _is_needless(o, dictionary)]
    check = _Check(device, node, dictionary, report)
    absent: dict[int, None] = {}
    for required, span in objects:
        index = required.index
        is_needed = required.value is not None or (node.lss and index == IDENTITY)
        if index in absent or not is_needed:
            continue
        if index not in dictionary.indices:
            absent[index] = None
        check.value(required, _place(device, required, span))
    for frame in frames:
        if frame.pdo is not None:
            check.mapping(frame)
    return objects


def _is_needless(required: ObjectValue, dictionary: Dictionary) -> bool:
    """Returns whether a TPDO without an event timer is required to have none."""
    is_timer = TPDO <= required.index < _END_OF_PDOS and required.subindex == EVENT_TIMER
    is_off = is_timer and required.value == 0
    return is_off and dictionary.get(required.index, EVENT_TIMER) is None


def _place(device: Device, required: ObjectValue, span: Span) -> Span:
    """Returns the source span of the key from which a value follows."""
    if span != device.can.where:
        return span
    address = device.address
    is_serial = (required.index, required.subindex) == _SERIAL_NUMBER
    if is_serial and required.value is not None and address is not None:
        return (address.get("serial") or address).where
    key = device.can.get(required.name) or device.can.get("canopen")
    if required.value is None:
        key = device.can.get("lss")  # identifies a device by all four parts of its identity
    if required.index == SYNC_COB_ID:
        keys = (frame.get("synchronous") for frame in entries(device.can.get("frames")).values())
        key = next(filter(None, keys), key)
    return span if key is None else key.where


class _Check(NamedTuple):
    device: Device
    node: Node
    dictionary: Dictionary
    report: Report

    def value(self, required: ObjectValue, span: Span) -> None:
        """Checks that the device holds a required value, or can hold it after a write."""
        entry = self.dictionary.get(required.index, required.subindex)
        if entry is None:
            self._absent(required.index, required.subindex, f"`{required.name}`", span)
            return
        number, stated = required.value, entry.number("value", self.node.id)
        if number is None:
            return  # the device must only have it
        if required.access == "ro":
            is_serial = (required.index, required.subindex) == _SERIAL_NUMBER
            if stated is not None and stated != number and not is_serial:
                self._conflict(entry, f"is {_shown(stated)}, not {_shown(number)}", required, span)
            return
        access = entry.fields["access"]
        if access and not entry.is_writable:
            if stated != number:
                has = "" if stated is None else f" and has the value {_shown(stated)}"
                text = f"cannot be written (`{access}`){has}; {_shown(number)} is required"
                self._conflict(entry, text, required, span)
            return
        self._size(entry, required, span)
        low, high = entry.limits(self.node.id)
        if (low is not None and number < low) or (high is not None and number > high):
            limits = [f"at least {_shown(low)}"] if low is not None else []
            limits += [f"at most {_shown(high)}"] if high is not None else []
            text = f"must be {' and '.join(limits)}, not {_shown(number)}"
            self._conflict(entry, text, required, span)

    def _size(self, entry: Entry, required: ObjectValue, span: Span) -> None:
        """Checks the number of bytes, in which the boolean type has one too."""
        known = entry.type
        bits, has = OBJECT_TYPES[required.type][1], OBJECT_TYPES[known][1] if known else 0
        if entry.fields["type"] and (bits + 7) // 8 != (has + 7) // 8:
            self._conflict(entry, f"is {_type(entry)}, not {required.type}", required, span)

    def mapping(self, frame: FrameDefinition) -> None:
        """Checks that the device can have the objects of a PDO."""
        documents = entries(self.device.can.get("frames")).values()
        document = next((each for each in documents if each.where == frame.span), None)
        places = items(document.get("mapping")) if document is not None else ()
        received = frame.producer == MASTER
        pdo = f"{'RPDO' if received else 'TPDO'} {frame.pdo}"
        for (index, subindex, kind), place in zip(frame.mapping, places, strict=True):
            if received and index < _DUMMIES:
                continue
            entry = self.dictionary.get(index, subindex)
            if entry is None:
                self._absent(index, subindex, f"the {pdo}", place.span)
                continue
            access = entry.fields["access"]
            text = ""
            if not entry.fields["mappable"]:
                text = "cannot be in a PDO (`PDOMapping`)"
            elif access and access not in (_COMMAND_ACCESS if received else _REPORT_ACCESS):
                text = f"cannot be in a PDO of this direction (`{access}`)"
            elif entry.fields["type"] and entry.type != kind:
                text = f"is {_type(entry)}, not {kind}"
            if text:
                self._conflict(entry, text, pdo, place.span)

    def _absent(self, index: int, subindex: int, what: str, span: Span) -> None:
        is_whole = index not in self.dictionary.indices
        shown = f"0x{index:04X}" + ("" if is_whole else f":{subindex}")
        hint = "remove it from the module, or let `eds` name the file of this device"
        if RPDO <= index < _END_OF_PDOS:
            hint = "the device has no such PDO, or one with fewer objects: change the module"
        text = f"`{self.dictionary.file}` has no object {shown}, which {what} needs"
        self.report.add("can-eds-conflict", text, span, hint=hint)

    def _conflict(self, entry: Entry, text: str, what: ObjectValue | str, span: Span) -> None:
        name = f"`{what.name}`" if isinstance(what, ObjectValue) else what
        message = f"the object {entry.shown} of {name} {text}"
        if any((known.message, known.span) == (message, span) for known in self.report):
            return  # of another device of this type
        there = self.dictionary.span(entry.index, entry.subindex)
        labels = [Label(there, "the object in the EDS"), Label(self.device.span, "of this device")]
        self.report.add("can-eds-conflict", message, span, labels=labels, hint=_CORRECT)


def _type(entry: Entry) -> str:
    return entry.type or f"of the data type 0x{entry.fields['type']:04X}"


def _shown(number: int) -> str:
    return f"{number} ({number:#x})" if number > 9 else str(number)
