"""Simulated devices whose modules name an EDS: SDO answers, PDOs, and what the model keeps."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.compiler.bus.test_eds_checks import MODULE, OBJECTS, check
from tests.simulation.bus.master import Master, Refused
from thorvaldc.can.canopen import NmtCommand
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.model.model_json import from_json, to_json
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

RESET, UNKNOWN, NO_SUBINDEX, READ_ONLY, WRITE_ONLY, RANGE = (
    NmtCommand.RESET_NODE,
    0x06020000,
    0x06090011,
    0x06010002,
    0x06010001,
    0x06090030,
)
OWN = """\
2004 rw 6 1234 <10 >2000
2005 ro 3 -7
2006 wo 5 1
2007 ro 9
2008 rw 1B 5 <1 >9
1008 const 7 5
1010sub1 rw 7 1
"""


def robot(folder: Path, module: str = MODULE) -> Robot:
    """Returns a robot with two devices, which have the ids 5 and 6."""
    assert check(folder, module, OBJECTS + OWN) == []
    model = compile_file(folder / "robot.yaml").model
    assert isinstance(model, Robot)
    return model


@pytest.fixture
def master(tmp_path: Path) -> Master:
    simulated = SimulatedRobot(robot(tmp_path))
    simulated.power_on()
    simulated.run(0.3)
    return Master(simulated.interface())


def test_an_object_has_the_default_value_of_the_eds(master: Master) -> None:
    assert master.number(5, 0x2004) == 1234
    assert master.number(5, 0x2005, signed=True) == -7
    assert master.number(5, 0x1018, 1) == 0x123
    assert master.number(5, 0x1018, 4) == 0x77
    assert master.read(5, 0x2007) == b""
    assert master.read(5, 0x2008) == b""  # of 64 bits
    assert master.read(5, 0x1008) == b"CANopen device"  # the EDS states a number
    assert len(master.read(6, 0x2000)) == 2
    assert [master.number(node, 0x1400, 1) for node in (5, 6)] == [0x205, 0x206]
    assert master.number(5, 0x1600, 1) == 0x50008


@pytest.mark.parametrize(
    ("index", "subindex", "code"),
    [
        (0x2F00, 0, UNKNOWN),
        (0x1003, 0, UNKNOWN),  # of every other simulated device
        (0x2004, 1, NO_SUBINDEX),
        (0x1800, 3, NO_SUBINDEX),
        (0x2006, 0, WRITE_ONLY),
    ],
)
def test_what_the_eds_does_not_have_cannot_be_read(
    master: Master, index: int, subindex: int, code: int
) -> None:
    with pytest.raises(Refused) as refused:
        master.read(5, index, subindex)
    assert refused.value.code == code


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "code"),
    [
        (0x2F00, 0, 1, 1, UNKNOWN),
        (0x2005, 0, 1, 2, READ_ONLY),
        (0x1400, 1, 0x205, 4, READ_ONLY),
        (0x1600, 0, 0, 1, READ_ONLY),
        (0x2004, 0, 9, 2, RANGE),
        (0x2004, 0, 2001, 2, RANGE),
        (0x2004, 0, 100, 4, 0x06070010),
    ],
)
def test_what_the_eds_excludes_cannot_be_written(
    master: Master, index: int, subindex: int, value: int, size: int, code: int
) -> None:
    with pytest.raises(Refused) as refused:
        master.write(5, index, subindex, value, size)
    assert refused.value.code == code


def test_a_written_value_is_stored(master: Master) -> None:
    for value in (20, 30):
        master.write(5, 0x2004, 0, value, 2)
        if value == 20:
            master.write(5, 0x1010, 1, 0x65766173, 4)
    master.nmt(RESET, 5)
    master.interface.sleep(0.3)
    assert master.number(5, 0x2004) == 20
    assert master.number(6, 0x2004) == 1234


def test_a_device_sends_and_receives_its_pdos(master: Master) -> None:
    master.write(5, 0x1800, 5, 100, 2)
    assert master.all(0x185, 0.5) == []
    master.nmt(NmtCommand.START)
    reports = master.all(0x185, 1.0)
    assert len(reports) in (10, 11)
    assert set(reports) == {bytes(4)}
    master.send(0x205, bytes([9, 33]))
    master.interface.sleep(0.01)
    assert master.number(5, 0x3000) == 0
    master.send(0x80, b"")
    master.interface.sleep(0.01)
    assert master.number(5, 0x3000) == 33


def test_a_model_that_was_read_back_has_no_eds(tmp_path: Path) -> None:
    model = robot(tmp_path)
    text = to_json(model)
    again = from_json(text)
    assert isinstance(again, Robot)
    assert again == model
    described = [len(node.described) for m in (model, again) for node in m.buses[0].nodes]
    assert described == [len((OBJECTS + OWN).splitlines())] * 2 + [0, 0]
    assert "described" not in text
