"""Bus load, addresses and wiring of a robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.bus import Bus, Channel, Node
from thorvaldc.model.robot import Actuator, Robot


@dataclass(frozen=True, slots=True)
class Address:
    """A node on a bus and its address.

    - ``bus``, ``name``, ``module``, ``protocol``: as in the model.
    - ``id``, ``id_space``: number of the node and the group of numbers, 0 and empty for a device
      without an address.
    - ``automatic``: true if the compiler chose the number.
    - ``serial``: serial number that the robot file states, or ``None``.
    - ``label``: text for a label on the device.
    """

    bus: str
    name: str
    module: str
    protocol: str
    id: int
    id_space: str
    automatic: bool
    serial: str | None
    label: str


@dataclass(frozen=True, slots=True)
class BusFacts:
    """A CAN bus.

    - ``bitrate``: bit rate in bit/s.
    - ``load``: worst-case bus load, 0 to 1.
    - ``frames``: number of frame definitions.
    - ``period``: period of the control cycle in s.
    - ``master_id``: CANopen node id of the master.
    """

    name: str
    bitrate: si.BitsPerSecond
    load: si.Number
    frames: int
    period: si.Seconds
    master_id: int
    addresses: tuple[Address, ...]


@dataclass(frozen=True, slots=True)
class Wire:
    """A motor with its encoder, and the channel of the motor controller that it is wired to.

    - ``motor``, ``role``, ``joint``, ``gear_ratio``, ``encoder_ppr``, ``max_torque``: as in
      ``Actuator``; empty and 0 for a channel without a motor.
    - ``bus``, ``node``, ``id``, ``channel``: the channel; empty and 0 for a motor without a motor
      controller on a bus.
    """

    motor: str
    module: str
    role: str
    joint: str
    gear_ratio: si.Number
    encoder_ppr: int
    max_torque: si.NewtonMetres
    bus: str
    node: str
    id: int
    channel: str


def buses_of(robot: Robot) -> tuple[BusFacts, ...]:
    """Return the buses of a robot with the addresses of their nodes."""
    return tuple(
        BusFacts(
            bus.name,
            bus.bitrate,
            bus.load,
            len(bus.frames),
            bus.sync_period,
            bus.master_id,
            tuple(_address(robot, bus, node) for node in bus.nodes),
        )
        for bus in robot.buses
    )


def _address(robot: Robot, bus: Bus, node: Node) -> Address:
    number = f"{node.id} (0x{node.id:02X})" if node.id_space else "no address"
    return Address(
        bus.name,
        node.name,
        node.module,
        node.protocol,
        node.id,
        node.id_space,
        node.automatic,
        node.serial,
        f"{robot.name} {bus.name}: {node.name} {number}",
    )


def wiring_of(robot: Robot) -> tuple[Wire, ...]:
    """Return the motors by bus, node and channel, then channels without a motor, then motors
    without a channel."""
    actuators = {actuator.name: actuator for actuator in robot.actuators}
    wires: list[Wire] = []
    spare: list[Wire] = []
    for bus, node, channel in _channels(robot):
        wire = _wire(actuators.pop(channel.actuator or "", None), bus, node, channel)
        (wires if wire.motor else spare).append(wire)
    return (
        *wires,
        *spare,
        *(_wire(actuator, None, None, None) for actuator in actuators.values()),
    )


def _channels(robot: Robot) -> Iterator[tuple[Bus, Node, Channel]]:
    for bus in robot.buses:
        for node in bus.nodes:
            for channel in node.channels:
                yield bus, node, channel


def _wire(
    actuator: Actuator | None, bus: Bus | None, node: Node | None, channel: Channel | None
) -> Wire:
    return Wire(
        motor=actuator.name if actuator else "",
        module=actuator.module if actuator else "",
        role=actuator.role if actuator else channel.role if channel else "",
        joint=actuator.joint if actuator else "",
        gear_ratio=actuator.gear_ratio if actuator else 0.0,
        encoder_ppr=actuator.encoder_ppr if actuator else 0,
        max_torque=actuator.max_torque if actuator else 0.0,
        bus=bus.name if bus else "",
        node=node.name if node else "",
        id=node.id if node else 0,
        channel=channel.name if channel else "",
    )
