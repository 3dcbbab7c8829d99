"""Identifiers with 29 bits, also of J1939, and big-endian signals in module and robot files."""

from __future__ import annotations

import pytest

from tests.devices import MOTORS, Bench, frame, signal, simple
from thorvaldc.model.bus import EXTENDED, Bus, key_text

J1939 = "{priority: %s, pgn: %s, source: %s}"


@pytest.fixture
def bench() -> Bench:
    return Bench()


def add(bench: Bench, cob_id: object, more: str = "", kind: str = "broadcast") -> None:
    """Adds a device with one frame; ``cob_id`` and further keys are YAML text."""
    text = simple(kind=kind).replace("cob_id: 400", f"cob_id: {cob_id}{more}")
    name = f"my/device{len(bench.devices)}"
    bench.add(
        name, len(bench.devices) + 1, text=text, wires={"motor": MOTORS[2 * len(bench.devices)]}
    )


def relayed(bench: Bench, cob_id: str, more: str = "") -> Bus:
    (bus,) = bench.build(
        foreign=f"\na: {{frames: {{x: {{cob_id: {cob_id}{more}, direction: report, rate: 1}}}}}}\n"
    )
    return bus


# -- identifiers -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cob_id", "extended", "code"),
    [
        ("0x7FF", False, "can-cob-id-restricted"),
        ("0x800", False, "can-cob-id-range"),
        ("0x1FFFFFFF", True, ""),
        ("0x20000000", True, "can-cob-id-range"),
        ("-1", True, "can-cob-id-range"),
        ("0.5", True, "can-cob-id-range"),
        ("0x000", True, ""),  # NMT has 11 bits
        ("0x7FF", True, ""),
        ('"${0x18FF5000 + 1}"', True, ""),
    ],
)
def test_identifiers_of_modules(bench: Bench, cob_id: str, extended: bool, code: str) -> None:
    add(bench, cob_id, ", extended: true" if extended else "")
    (bus,) = bench.build()
    assert " ".join(d.code.name for d in bench.report) == code
    if not code:
        assert frame(bus, "d1_a").extended


@pytest.mark.parametrize("cob_id", ["0x18FF5001", "0x800"])
def test_an_identifier_with_29_bits_needs_its_key(bench: Bench, cob_id: str) -> None:
    relayed(bench, cob_id)
    diagnostic = bench.only_diagnostic("can-cob-id-range")
    assert f"`x` of `a` has the identifier {cob_id.lower()}" in diagnostic.message
    assert "extended: true" in str(diagnostic.hint)
    bus = relayed(Bench(), cob_id, ", extended: true")
    assert (frame(bus, "a_x").cob_id, frame(bus, "a_x").extended) == (int(cob_id, 16), True)


def test_the_number_alone_is_no_conflict(bench: Bench) -> None:
    """A drive of CANopen, and frames with its numbers and 29 bits."""
    bench.drive(1)
    text = "".join(
        f"    x{number}: {{cob_id: {number}, extended: true, direction: {direction}, rate: 1}}\n"
        for number, direction in ((0x000, "command"), (0x201, "command"), (0x181, "report"))
    )
    (bus,) = bench.build(foreign=f"\na:\n  frames:\n{text}")
    assert not list(bench.report)
    keys = [f.key for f in bus.frames]
    assert len(keys) == len({*keys})
    assert {0x201, 0x201 | EXTENDED} <= {*keys}
    times = {f.key: f.response_time for f in bus.frames}
    assert times[0x000 | EXTENDED] is not None, "a bus with both kinds has response times"


def test_two_extended_frames_conflict(bench: Bench) -> None:
    add(bench, "0x181", ", extended: true")
    add(bench, "0x181", ", extended: true")
    bench.build()
    assert "0x00000181" in bench.only_diagnostic("can-cob-id-conflict").message


def test_standard_frames_win_the_arbitration(bench: Bench) -> None:
    """Of equal first 11 bits, the standard frame is the more urgent one."""
    add(bench, 0x123 << 18, ", extended: true")
    add(bench, 0x123)
    add(bench, 0x122 << 18 | 0x3FFFF, ", extended: true")
    (bus,) = bench.build()
    order = sorted((f for f in bus.frames if f.kind == "broadcast"), key=lambda f: f.arbitration)
    assert [f.producer for f in order] == ["d3", "d2", "d1"]


def test_texts_tell_the_kinds_apart() -> None:
    assert [key_text(0x81), key_text(0x81 | EXTENDED)] == ["0x081", "0x00000081"]


# -- J1939 -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "identifier"),
    [
        (J1939 % (6, 0xFF50, 1), 0x18FF5001),
        (J1939 % (3, 61444, 0), 0x0CF00400),  # EEC1 of an engine, as in J1939-71
        ("{priority: 6, pgn: 0xEA00, source: 249, destination: 255}", 0x18EAFFF9),  # a request
        ("{priority: 7, pgn: 0x3FFFF, source: 255}", 0x1FFFFFFF),
        (J1939 % (0, "0xF000", '"${id + 0x7F}"'), 0x00F00080),
    ],
)
def test_identifiers_of_j1939(bench: Bench, parts: str, identifier: int) -> None:
    add(bench, parts)
    (bus,) = bench.build()
    assert not list(bench.report)
    assert (frame(bus, "d1_a").cob_id, frame(bus, "d1_a").extended) == (identifier, True)


@pytest.mark.parametrize(
    ("parts", "more", "text"),
    [
        (J1939 % (8, 0xFF50, 1), "", "the priority 8; it must be 0 to 7"),
        (J1939 % (6, 0x40000, 1), "", "the pgn 262144; it must be 0 to 262143"),
        (J1939 % (6, 0xFF50, 256), "", "the source 256; it must be 0 to 255"),
        (J1939 % (6, 0xEA00, 1), "", "the PGN 0xea00 and no `destination`"),
        ("{priority: 6, pgn: 0xEA05, source: 1, destination: 5}", "", "whose lower 8 bits"),
        ("{priority: 6, pgn: 0xFF50, source: 1, destination: 5}", "", "and a `destination`"),
        (J1939 % (6, 0xFF50, 1), ", extended: false", "which has 29 bits"),
    ],
)
def test_impossible_identifiers_of_j1939(bench: Bench, parts: str, more: str, text: str) -> None:
    relayed(bench, parts, more)
    diagnostic = bench.only_diagnostic("can-cob-id-range")
    assert text in diagnostic.message
    assert diagnostic.span is not None


# -- big-endian signals ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("signals", "length", "code", "text"),
    [
        ("{a: {start: 7, length: 32, big_endian: true}}", 4, "", ""),
        ("{a: {start: 7, length: 33, big_endian: true}}", 4, "can-signal-bounds", "has 32 from"),
        ("{a: {start: 0, length: 9, big_endian: true}}", 2, "", ""),
        ("{a: {start: 0, length: 10, big_endian: true}}", 2, "can-signal-bounds", "has 9 from"),
        ("{a: {start: 40, length: 2, big_endian: true}}", 2, "can-signal-bounds", "has 0 from"),
        ("{a: {start: -1, length: 2, big_endian: true}}", 2, "can-signal-bounds", "bit -1"),
        ("{a: {start: 7, length: 9999999999, big_endian: true}}", 8, "can-signal-bounds", ""),
        (
            "{a: {start: 7, length: 12, big_endian: true}, b: {start: 8, length: 4}}",
            2,
            "",
            "",
        ),
        (
            "{a: {start: 7, length: 12, big_endian: true}, b: {start: 8, length: 5}}",
            2,
            "can-signal-overlap",
            "`a` (bits 7 to 12, big endian) and `b` (bits 8 to 12) share bits",
        ),
        ("{a: {start: 7, length: 32, big_endian: true, floating_point: true}}", 4, "", ""),
    ],
)
def test_layouts(bench: Bench, signals: str, length: int, code: str, text: str) -> None:
    bench.add("my/device", 1, text=simple(signals, length=length), wires={"motor": MOTORS[0]})
    (bus,) = bench.build()
    assert " ".join(d.code.name for d in bench.report) == code
    if code:
        diagnostic = bench.only_diagnostic(code)
        assert text in diagnostic.message
        assert diagnostic.span is not None
    else:
        assert signal(bus, "d1_a", "a").big_endian


@pytest.mark.parametrize(
    ("more", "signals"),
    [
        (", extended: true", "{a: {start: 0, length: 8}}"),
        ("", "{a: {start: 7, length: 8, big_endian: true}}"),
    ],
)
def test_pdos_are_standard_frames_with_little_endian_signals(
    bench: Bench, more: str, signals: str
) -> None:
    text = simple(signals, length=1)
    more += ", pdo: 1, mapping: [[0x2000, 1, unsigned8]]"
    text = text.replace("cob_id: 400", f"cob_id: 400{more}")
    bench.add("my/device", 1, text=text, wires={"motor": MOTORS[0]})
    bench.build()
    assert "is a PDO" in bench.only_diagnostic("can-pdo-mapping").message
