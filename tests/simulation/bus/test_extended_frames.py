"""Frames with 29-bit identifiers on the simulated bus, beside standard frames of equal numbers."""

from __future__ import annotations

import functools

import pytest

from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import CIA402, at_home, compiled
from tests.simulation.bus.test_fault_injection import Run, fault
from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.commissioning.bus_configuration import configuration_of
from thorvaldc.commissioning.bus_master import BusMaster
from thorvaldc.commissioning.verify import verify
from thorvaldc.model import Robot
from thorvaldc.model.bus import EXTENDED
from thorvaldc.model.bus_identity import Heard, wrong_buses
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.simulation.bus.battery_and_io_devices import ForeignDevice
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

COMMAND, STATE = 0x201, 0x181  # also the command and the report of the drive with the id 1
TOOL = """
  tool:
    frames:
      command: {cob_id: 0x201, extended: true, direction: command, rate: 100 Hz}
      state: {cob_id: 0x181, extended: true, direction: report, rate: 100 Hz, length: 4}
      tractor: {cob_id: {priority: 6, pgn: 0xFF50, source: 1}, direction: report, rate: 10 Hz}
"""


@functools.cache
def robot() -> Robot:
    """Returns a robot with a tool whose frames have the numbers of a drive, and 29 bits."""
    return at_home(compiled(CIA402.replace("\nmodules:", f"{TOOL.rstrip()}\nmodules:")))


def test_the_relay_and_the_drives_do_not_mix_the_kinds_up() -> None:
    rig = Rig(robot())
    tool = rig.simulated.devices["tool"]
    assert isinstance(tool, ForeignDevice)
    rig.drive(seconds=1.0)
    assert tool.commands == [], "it gets none of the commands of the drive"
    sender = rig.simulated.interface(name="program")
    command = CanFrame(COMMAND, b"\1\2", extended=True)
    for number in range(20):
        rig.base.nodes.send_to_device(command, rig.now)
        sender.send(CanFrame(STATE, bytes([number]), extended=True))
        rig.run(0.02)
    assert rig.state is BaseState.ACTIVE, rig.reason
    assert {*tool.commands} == {command}
    relayed = {r.frame for r in rig.base.nodes.from_devices()}
    assert relayed
    assert all((f.id, f.extended) == (STATE, True) for f in relayed if f.id == STATE)
    assert rig.base.warnings(rig.now) == []
    with pytest.raises(RequestRefused, match="0x201: not allowed"):
        rig.base.nodes.send_to_device(CanFrame(COMMAND, b""), rig.now)
    assert rig.base.nodes.relay_drops()["0x201 not allowed"] == 1


def test_the_service_sends_and_returns_both_kinds() -> None:
    rig = Rig(robot())
    rig.ready()
    services = {service.name: service for service in rig.base.services()}
    values = {"cob_id": COMMAND, "data": "01", "extended": True}
    services["send_to_device"].call(now=rig.now, **values)
    rig.run(0.1)
    answers = services["from_devices"].call()
    assert {(a["cob_id"], a["extended"]) for a in answers} >= {(STATE, True)}


def test_verify_knows_extended_frames() -> None:
    simulated = SimulatedRobot(robot())
    simulated.power_on()
    interface = simulated.interface(receive_limit=100_000)
    other = simulated.interface(name="other")
    bus = robot().buses[0]
    master = BusMaster(interface, bus)
    frames = [
        CanFrame(STATE, b"\1", extended=True),  # in the map
        CanFrame(0x581, bytes(8), extended=True),  # no SDO response
        CanFrame(0x701, b"\0", extended=True),  # no boot-up message
    ]

    def repeat() -> None:
        for frame in frames:
            other.send(frame)
        simulated.timeline.after(to_ns(0.05), repeat)

    repeat()
    master.listen(0.05)
    assert master.surplus == {}
    assert master.boots.count(1) <= 1
    assert STATE | EXTENDED in master.received
    checks = verify(master, configuration_of(robot(), bus), bus).checks
    (unknown,) = [c for c in checks if c.what == "frames that are not in the file"]
    assert unknown.actual == "0x00000581, 0x00000701"


def test_buses_are_known_by_keys() -> None:
    first = robot().buses[0]
    (state,) = [f for f in first.frames if f.name == "tool_state"]
    second = type(first)("other", 500_000, 0.02, (), (state,), first.span)
    rest = tuple(f for f in first.frames if f is not state)
    first = type(first)("main", 500_000, 0.02, (), rest, first.span)
    assert wrong_buses([first, second], {"main": Heard([state.key], [])})
    assert not wrong_buses([first, second], {"main": Heard([STATE], [])})


@pytest.mark.parametrize(("form", "lost"), [("standard", STATE), ("extended", STATE | EXTENDED)])
def test_a_fault_concerns_one_kind(form: str, lost: int) -> None:
    more = {"cob_id": STATE, "format": form}
    run = Run(
        fault("lost_frames", None, at=0.0, share=1.0, **more),
        fault("forged_frames", None, at=0.0, period=0.01, cob_id=STATE, format="extended"),
        fault("forged_frames", None, at=0.0, period=0.01, cob_id=STATE, data=bytes(8)),
        robot=robot(),
    )
    run.simulated.run(0.5)
    keys = {r.frame.key for r in run.master.interface.received if r.frame.id == STATE}
    assert keys == {STATE, STATE | EXTENDED} - {lost}
    lengths = {len(r.frame.data) for r in run.master.interface.received if r.frame.extended}
    assert lengths <= {4}, "random data has the length of the frame with this format"
