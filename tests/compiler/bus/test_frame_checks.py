"""Layouts and scales of the signals of CAN frames."""

from __future__ import annotations

import dataclasses
import math

import pytest

from tests.devices import (
    DRIVE,
    MOTORS,
    Bench,
    frame,
    line,
    signal,
    simple,
)


@pytest.fixture
def bench() -> Bench:
    return Bench()


# -- layouts --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("signals", "length", "code"),
    [
        ("{a: {start: 0, length: 32}, b: {start: 32, length: 32}}", 8, ""),
        ("{a: {start: 0, length: 33}, b: {start: 32, length: 32}}", 8, "can-signal-overlap"),
        ("{a: {start: 32, length: 33}}", 8, "can-signal-bounds"),
        ("{a: {start: 9, length: 8}}", 2, "can-signal-bounds"),
        ("{a: {start: 8, length: 8}}", 2, ""),
        ("{a: {start: 0, length: 0}}", 2, "can-signal-bounds"),
        ("{a: {start: 0, length: 0, signed: true}}", 2, "can-signal-bounds"),
        ("{a: {start: 0, length: -3, signed: true}}", 2, "can-signal-bounds"),
        ("{a: {start: 0, length: 1000000000000}}", 2, "can-signal-bounds"),
        ("{a: {start: -1, length: 2}}", 2, "can-signal-bounds"),
        ("{a: {start: 0, length: '${8 / 3}'}}", 2, "wrong-type"),
        ("{a: {start: 0, length: 8}}", 9, "can-frame-length"),
        ("{a: {start: 0, length: 8, choices: {on_: 255}}}", 8, ""),
        ("{a: {start: 0, length: 8, choices: {on_: 256}}}", 8, "can-choice-range"),
        ("{a: {start: 0, length: 8, signed: true, choices: {on_: 128}}}", 8, "can-choice-range"),
        ("{a: {start: 0, length: 8, scale: 0}}", 8, "can-scale"),
        ("{a: {start: 0, length: 64, floating_point: true}}", 8, ""),
        ("{a: {start: 4, length: 32, floating_point: true, scale: -2}}", 8, ""),
        ("{a: {start: 0, length: 33, floating_point: true}}", 8, "can-signal-floating-point"),
        (
            "{a: {start: 0, length: 32, floating_point: true, signed: true}}",
            8,
            "can-signal-floating-point",
        ),
        (
            "{a: {start: 0, length: 32, floating_point: true, choices: {on_: 1}}}",
            8,
            "can-signal-floating-point",
        ),
        (
            "{a: {start: 0, length: 32, floating_point: true, multiplexer: true}}",
            8,
            "can-signal-floating-point",
        ),
        (
            "{m: {start: 0, length: 8, multiplexer: true},"
            " a: {start: 8, length: 8, selected_by: [1]},"
            " b: {start: 8, length: 8, selected_by: [2, 255]}}",
            8,
            "",
        ),
        (
            "{m: {start: 0, length: 8, multiplexer: true},"
            " a: {start: 8, length: 8, selected_by: [1, 2]},"
            " b: {start: 8, length: 8, selected_by: [2]}}",
            8,
            "can-signal-overlap",
        ),
        (
            "{m: {start: 0, length: 8, multiplexer: true},"
            " a: {start: 8, length: 8, selected_by: [256]}}",
            8,
            "can-multiplexer",
        ),
        (
            "{m: {start: 0, length: 8, multiplexer: true},"
            " a: {start: 8, length: 8, selected_by: [1]},"
            " b: {start: 12, length: 8}}",
            8,
            "can-signal-overlap",
        ),
        (
            "{m: {start: 0, length: 8, multiplexer: true},"
            " b: {start: 12, length: 8},"
            " a: {start: 8, length: 8, selected_by: [1]}}",
            8,
            "can-signal-overlap",
        ),
        ("{a: {start: 8, length: 8, selected_by: [1]}}", 8, "can-multiplexer"),
        (
            "{m: {start: 0, length: 8, multiplexer: true},"
            " n: {start: 8, length: 8, multiplexer: true}}",
            8,
            "can-multiplexer",
        ),
        ("{a: {start: 0, length: 8, channel: moter}}", 8, "channel-unknown"),
    ],
)
def test_layout(bench: Bench, signals: str, length: int, code: str) -> None:
    bench.add("my/a", 6, text=simple(signals, length=length), wires={"motor": MOTORS[0]})
    bench.build()
    assert " ".join(d.code.name for d in bench.report) == code


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (("length: 8}}", "length: 0, signed: true}}"), "can-signal-bounds"),
        (("0x190 + id", "0x9000"), "can-cob-id-range"),
        (("0x190 + id", "1 / 0"), "expression-value"),
        (("on_demand", "'${nothing}'"), "expression-name"),
    ],
)
def test_a_fault_of_a_module_used_twice_is_one_fault(
    bench: Bench, change: tuple[str, str], code: str
) -> None:
    text = simple().replace("cob_id: 400", "cob_id: '${0x190 + id}'").replace(*change)
    bench.add("my/a", 6, text=text, wires={"motor": MOTORS[0]})
    bench.add("my/a", 7, text=text, wires={"motor": MOTORS[2]})
    bench.build()
    assert {d.code.name for d in bench.report} == {code}
    assert len({d.span for d in bench.report}) == 1


def test_many_signals_take_no_time(bench: Bench) -> None:
    signals = ", ".join(f"s{i}: {{start: 32, length: 32, selected_by: [{i}]}}" for i in range(5000))
    text = simple(f"{{which: {{start: 0, length: 16, multiplexer: true}}, {signals}}}")
    bench.add("my/a", 6, text=text, wires={"motor": MOTORS[0]})
    (bus,) = bench.build()
    assert not list(bench.report)
    assert len(frame(bus, "d1_a").signals) == 5001


def test_overlap_is_found_among_signals_of_unwired_channels(bench: Bench) -> None:
    signals = "{a: {start: 0, length: 8, channel: motor}, b: {start: 4, length: 8}}"
    bench.add("my/a", 6, text=simple(signals))
    bench.build(motors=())
    assert "can-signal-overlap" in [d.code.name for d in bench.report]


# -- scales ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "fits"),
    [
        ("length: 16, signed: true, scale: 0.001", True),
        ("length: 8, signed: true, scale: 0.1", True),  # 12.7 rad/s
        ("length: 8, signed: true, scale: 0.05", False),  # 6.35 rad/s, the wheel has 7.48
        ("length: 8, signed: true, scale: -0.1", True),
        ("length: 16, scale: 0.001", False),  # unsigned: never backwards
        ("length: 16, scale: 0.001, offset: -10", True),
        ("length: 16, signed: true, scale: 0.001, maximum: 7.4", False),
        ("length: 16, signed: true, scale: 0.001, maximum: 7.48", True),
        ("length: 16, signed: true, scale: 0.001, minimum: -7.4", False),
        ("length: 16, signed: true, scale: 0.001, minimum: 0", True),  # a limit of the speed
        ("length: 16, signed: true, scale: 0.0001, minimum: 0", False),
    ],
)
def test_full_speed_must_fit(bench: Bench, field: str, fits: bool) -> None:
    signals = f"{{a: {{start: 0, {field}, channel: motor, unit: rad/s}}}}"
    bench.add("my/a", 6, text=simple(signals), wires={"motor": MOTORS[0]})
    bench.build()
    if fits:
        assert not list(bench.report)
    else:
        diagnostic = bench.only_diagnostic("can-scale")
        assert diagnostic.span == line(1)
        assert diagnostic.labels[0].span.file == "my/a/module.yaml"


@pytest.mark.parametrize(
    ("limits", "fits"), [((-1.0, 1.27), True), ((-1.0, 1.3), False), ((-1.3, 1.0), False)]
)
def test_full_angle_must_fit(bench: Bench, limits: tuple[float, float], fits: bool) -> None:
    text = simple(
        "{a: {start: 0, length: 8, signed: true, scale: 0.01, channel: motor, unit: rad}}"
    ).replace("role: propulsion", "role: steering")
    bench.add("my/a", 6, text=text, wires={"motor": MOTORS[1]}, limits=limits)
    bench.build()
    assert [d.code.name for d in bench.report] == ([] if fits else ["can-scale"])


def test_a_motor_too_fast_for_tpdo1(bench: Bench) -> None:
    fast = dataclasses.replace(MOTORS[0], motor_max_speed=3500.0, max_velocity=3500.0 / 42)
    bench.add(DRIVE, 1, {"propulsion": fast, "steering": MOTORS[1]})
    bench.build()
    assert "propulsion_velocity" in bench.only_diagnostic("can-scale").message


def test_steering_without_limits_counts_as_half_a_turn_each_way(bench: Bench) -> None:
    bench.add(DRIVE, 1, {"propulsion": MOTORS[0], "steering": MOTORS[1]}, limits=(None, None))
    (bus,) = bench.build()
    assert not list(bench.report)
    assert signal(bus, "d1_rpdo4", "position").scale == pytest.approx(math.pi / 1000)
