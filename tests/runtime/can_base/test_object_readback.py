"""Objects that are read and compared with the robot file, by the bytes of the SDO frames."""

from __future__ import annotations

import struct

import pytest

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import ObjectValue
from thorvaldc.runtime.can_base.node_watchdog import (
    ANSWER_TIME,
    TRIES,
    ObjectReadback,
    ObjectSupervision,
    SupervisedNode,
)


def number(index: int, subindex: int, type_name: str, value: int) -> ObjectValue:
    return ObjectValue(f"object {index:x}", index, subindex, type_name, value)


FIRST = number(0x1017, 0, "unsigned16", 100)
SECOND = number(0x607D, 1, "integer32", -5)


def upload(entry: ObjectValue) -> CanFrame:
    return CanFrame(0x605, struct.pack("<BHB4x", 0x40, entry.index, entry.subindex))


def response(entry: ObjectValue, value: int, command: int = 0x43) -> bytes:
    return struct.pack("<BHBi", command, entry.index, entry.subindex, value)


def test_objects_are_read_one_after_another() -> None:
    readback = ObjectReadback(0x605, 0x585, [FIRST, SECOND])
    assert not readback.finished
    assert readback.next_request(1.0) == upload(FIRST)
    assert readback.next_request(1.0) is None, "a response is awaited"
    readback.take_response(response(SECOND, -5))
    assert readback.next_request(1.01) is None, "not the requested object"
    readback.take_response(response(FIRST, 100)[:7])
    assert readback.next_request(1.01) is None, "too short"
    readback.take_response(response(FIRST, 100))
    assert readback.next_request(1.02) == upload(SECOND)
    readback.take_response(response(SECOND, -5))
    assert (readback.finished, readback.problem) == (True, "")
    assert readback.next_request(9.0) is None


@pytest.mark.parametrize(
    ("entry", "value", "problem"),
    [
        (FIRST, 101, "object 1017 (0x1017:0) is 101, but must be 100"),
        (SECOND, 5, "object 607d (0x607d:1) is 5, but must be -5"),
    ],
)
def test_another_value_is_a_problem(entry: ObjectValue, value: int, problem: str) -> None:
    readback = ObjectReadback(0x605, 0x585, [entry, FIRST])
    readback.take_response(response(entry, value))
    assert readback.problem == "", "nothing was requested"
    readback.next_request(0.0)
    readback.take_response(response(entry, value))
    assert readback.problem == problem
    assert readback.finished
    assert readback.next_request(9.0) is None


def test_an_abort_is_a_problem() -> None:
    readback = ObjectReadback(0x605, 0x585, [FIRST])
    readback.next_request(0.0)
    readback.take_response(response(SECOND, 0x06020000, 0x80))
    assert readback.problem == ""
    readback.take_response(response(FIRST, 0x06020000, 0x80))
    assert readback.problem.startswith("object 1017 (0x1017:0) cannot be read: ")


def test_a_request_without_response_is_repeated() -> None:
    readback = ObjectReadback(0x605, 0x585, [FIRST])
    now = 1.0
    for _ in range(TRIES):
        assert readback.next_request(now) == upload(FIRST)
        assert readback.next_request(now + 0.99 * ANSWER_TIME) is None
        now += 1.01 * ANSWER_TIME
    assert readback.next_request(now) is None
    assert readback.problem == "no response to the SDO upload of object 1017 (0x1017:0)"


def test_the_tries_of_each_object_are_counted_alone() -> None:
    readback = ObjectReadback(0x605, 0x585, [FIRST, SECOND])
    for k in range(TRIES):
        assert readback.next_request(2.0 * ANSWER_TIME * k) == upload(FIRST)
    readback.take_response(response(FIRST, 100))
    for k in range(TRIES):
        assert readback.next_request(100.0 + 2.0 * ANSWER_TIME * k) == upload(SECOND)


def test_a_value_in_a_segment() -> None:
    readback = ObjectReadback(0x605, 0x585, [FIRST, SECOND])
    readback.next_request(0.0)
    readback.take_response(response(FIRST, 2, 0x41))
    segment_request = CanFrame(0x605, bytes([0x60]) + bytes(7))
    assert readback.next_request(0.01) == segment_request
    assert readback.next_request(0.01) is None
    readback.take_response(struct.pack("<BH5x", 0x0B, 100))
    assert readback.problem == ""
    assert readback.next_request(0.02) == upload(SECOND)
    readback.take_response(response(SECOND, 4, 0x41))
    assert readback.next_request(0.03) == segment_request
    assert readback.next_request(0.04 + ANSWER_TIME) == upload(SECOND), "from the beginning"
    readback.take_response(response(SECOND, -5))
    assert (readback.finished, readback.problem) == (True, "")


def test_supervision_reads_all_nodes_in_turn() -> None:
    nodes = [
        SupervisedNode("a", 0x605, 0x585, (FIRST, SECOND)),
        SupervisedNode("without", 0x606, 0x586, ()),
        SupervisedNode("b", 0x607, 0x587, (FIRST,)),
    ]
    supervision = ObjectSupervision(nodes)
    sequence = []
    for k in range(6):
        now = 1.0 + k * 0.02
        request = supervision.next_request(now)
        assert request is not None
        assert supervision.next_request(now + 0.01) is None, "a response is awaited"
        index, _ = struct.unpack_from("<HB", request.data, 1)
        sequence.append((request.id, index))
        entry = FIRST if index == FIRST.index else SECOND
        name = "a" if request.id == 0x605 else "b"
        supervision.take_response("b" if name == "a" else "a", response(entry, 77))
        assert supervision.problem is None, "the response of another node"
        value = (100 if entry is FIRST else -5) if k < 5 else 77
        supervision.take_response(name, response(entry, value))
    assert sequence == [(0x605, 0x1017), (0x605, 0x607D), (0x607, 0x1017)] * 2
    assert supervision.problem is not None
    assert supervision.problem.text.startswith("b: object 1017 (0x1017:0) is 77")
    assert supervision.next_request(99.0) is None
    assert ObjectSupervision(nodes[1:2]).next_request(0.0) is None
