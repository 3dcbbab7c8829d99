"""Signals of a motor that is mounted the other way round."""

from __future__ import annotations

import dataclasses

import pytest

from tests.devices import CIA_402, DRIVE, MOTORS, Bench, frame, signal, simple
from thorvaldc.model import Bus, Signal

PROPULSION, STEERING = (dataclasses.replace(motor, inverted=True) for motor in MOTORS[:2])


@pytest.fixture
def bench() -> Bench:
    return Bench()


def signal_of(bench: Bench, field: str) -> Signal:
    """Returns the signal of an inverted motor that the module document describes."""
    text = simple(f"{{a: {{start: 0, channel: motor, {field}}}}}")
    bench.add("my/a", 6, text=text, wires={"motor": PROPULSION})
    (bus,) = bench.build()
    assert not list(bench.report)
    return signal(bus, "d1_a", "a")


@pytest.mark.parametrize(
    "field",
    [
        "unit: rad/s",
        "unit: rad",
        "unit: deg",
        "unit: rev",
        "unit: rev/s",
        "unit: rpm",
        "unit: rad/s^2",
        "unit: N m",
        "unit: '%'",
        "unit: rad, floating_point: true",
        "unit: rpm, signed: false, offset: -100",  # unsigned, and yet in both directions
    ],
)
def test_signals_with_a_direction(bench: Bench, field: str) -> None:
    signed = "" if "floating_point" in field or "signed" in field else ", signed: true"
    a = signal_of(bench, f"length: 32, scale: 0.5, {field}{signed}")
    offset = 100.0 if "offset" in field else 0.0
    assert (a.scale, a.offset) == (-0.5, offset)
    assert str(a.offset) == str(offset), "not -0.0"


@pytest.mark.parametrize(
    "field",
    [
        "signed: true",
        "signed: true, choices: {off_: 0}",
        "signed: true, unit: A",
        "signed: true, unit: W",
        "signed: true, unit: V",
        "signed: true, unit: degC",
        "signed: true, unit: counts",
        "unit: rpm",
        "unit: '%'",
        "signed: true, unit: rpm, minimum: 0",
        "signed: true, unit: rad/s, minimum: 0",
    ],
)
def test_signals_without_a_direction(bench: Bench, field: str) -> None:
    assert signal_of(bench, f"length: 32, scale: 0.5, {field}").scale == 0.5


def test_the_range_is_that_of_the_module_turned_round(bench: Bench) -> None:
    a = signal_of(bench, "length: 32, signed: true, unit: rpm, minimum: -300, maximum: 200")
    assert (a.minimum, a.maximum) == (-200.0, 300.0)
    a = signal_of(Bench(), "length: 32, signed: true, unit: rpm, maximum: 200")
    assert (a.minimum, a.maximum) == (-200.0, None)


def test_a_range_of_the_limits_is_that_of_the_joint(bench: Bench) -> None:
    """`lower` and `upper` are those of the motor controller, as its signals are."""
    text = simple(
        "{a: {start: 0, length: 32, signed: true, channel: motor, unit: rad, scale: 1e-6, "
        "minimum: '${motor.lower}', maximum: '${motor.upper}'}}"
    )
    text = text.replace("role: propulsion", "role: steering")
    motor = dataclasses.replace(STEERING, encoder_offset=0.1)
    bench.add("my/a", 6, text=text, wires={"motor": motor}, limits=(-1.0, 0.5))
    (bus,) = bench.build()
    assert not list(bench.report)
    a = signal(bus, "d1_a", "a")
    assert (a.minimum, a.maximum) == pytest.approx((-0.9, 0.6))
    assert (a.scale, a.offset) == (-1e-6, 0.1)


def scales(bus: Bus) -> dict[str, float]:
    return {f"{f.name}.{s.name}": s.scale for f in bus.frames for s in f.signals}


@pytest.mark.parametrize(
    ("controller", "turned"),
    [
        (
            DRIVE,
            {
                "rpdo1.speed",
                "rpdo4.position",
                "tpdo1.propulsion_velocity",
                "tpdo1.steering_velocity",
                "tpdo1.steering_position",
            },
        ),
        (
            CIA_402,
            {
                "rpdo1.propulsion_target_velocity",
                "rpdo2.steering_target_position",
                "tpdo1.propulsion_velocity",
                "tpdo2.steering_position",
                "tpdo3.propulsion_torque",
                "tpdo3.steering_torque",
            },
        ),
    ],
)
def test_the_signals_of_the_library(controller: str, turned: set[str]) -> None:
    found = []
    for motors in ((MOTORS[0], MOTORS[1]), (PROPULSION, STEERING)):
        bench = Bench()
        bench.add(controller, 1, dict(zip(("propulsion", "steering"), motors, strict=True)))
        (bus,) = bench.build()
        assert not list(bench.report)
        found.append(bus)
    usual, inverted = map(scales, found)
    assert {name for name in usual if inverted[name] == -usual[name]} == {
        f"d1_{name}" for name in turned
    }
    assert all(abs(inverted[name]) == abs(usual[name]) for name in usual)
    assert found[0].nodes[0].objects == found[1].nodes[0].objects
    assert frame(found[1], "d1_rpdo1").signals[0] == frame(found[0], "d1_rpdo1").signals[0]


def test_a_speed_that_does_not_fit_is_an_error_as_before(bench: Bench) -> None:
    text = simple("{a: {start: 0, length: 16, scale: 0.001, channel: motor, unit: rad/s}}")
    bench.add("my/a", 6, text=text, wires={"motor": PROPULSION})
    bench.build()
    assert "0 to 65.53 rad/s" in bench.only_diagnostic("can-scale").message
