"""Bus load, addresses and wiring of a robot, the energy of its batteries and its range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from thorvaldc.model import Actuator, Bus, Channel, Node, Robot
from thorvaldc.model import quantities as si
from thorvaldc.model.robot import stated_number
from thorvaldc.model.sums import float_sum


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

    - ``motor``, ``role``, ``joint``, ``gear_ratio``, ``encoder_ppr``, ``max_torque`` and
      ``inverted``: as in ``Actuator``; empty, 0 and false for a channel without a motor.
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
    inverted: bool = False


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
        inverted=actuator.inverted if actuator else False,
    )


# -- energy of the batteries and the range that it limits ---------------------------------------

POWER = "power"
"""Property of a sensor or node: electrical power in W that it draws while the robot is on."""


@dataclass(frozen=True, slots=True)
class BatteryFacts:
    """A battery enclosure.

    - ``present``: true if a battery is in the enclosure.
    - ``voltage``: nominal voltage in V, or ``None`` if the module does not state it.
    - ``capacity``: capacity in A s, or ``None`` if the module does not state it.
    - ``energy``: voltage times capacity in J, or ``None`` if one of them is not stated.
    """

    name: str
    module: str
    present: bool
    voltage: si.Volts | None
    capacity: si.AmpereSeconds | None
    energy: si.Joules | None


@dataclass(frozen=True, slots=True)
class Energy:
    """Energy and range of a robot on level ground.

    - ``energy``: energy of all batteries in J, or ``None`` if a module does not state it or the
      robot has no battery.
    - ``rolling_force``: force in N that the rolling resistance of the wheels needs.
    - ``power``: power of the electronics in W that the modules state, 0 if none states it.
    - ``connection``: ``parallel``, ``separate`` or ``None``, see ``Robot.battery_connection``.
    - ``has_common_source``: true if the robot has a ``Robot.common_source``.
    - ``voltage``, ``capacity``: nominal voltage in V and capacity in A s of the whole source: of
      the only battery, or of batteries in parallel, whose capacities add up. ``None`` if the robot
      has no common source or a module does not state its number.
    - ``standby``: energy divided by ``power`` in s, or ``None`` if a module does not state its
      power, or if the batteries are no common source.
    - ``standby_current``: ``power`` divided by ``voltage`` in A, of all batteries together, or
      ``None`` without a ``standby``.
    - ``missing``: the numbers that no module states, in words.
    """

    batteries: tuple[BatteryFacts, ...]
    connection: str | None
    has_common_source: bool
    voltage: si.Volts | None
    capacity: si.AmpereSeconds | None
    energy: si.Joules | None
    rolling_force: si.Newtons
    power: si.Watts
    standby: si.Seconds | None
    standby_current: si.Amperes | None
    missing: tuple[str, ...]


def energy_of(robot: Robot) -> Energy:
    """Return the energy and the range of a robot."""
    batteries = tuple(_batteries(robot))
    present = [battery for battery in batteries if battery.present]
    energies = [battery.energy for battery in present if battery.energy is not None]
    energy = float_sum(energies) if energies and len(energies) == len(present) else None
    force = float_sum(wheel.rolling_resistance * wheel.load for wheel in robot.wheels)
    consumers = list(_stated_powers(robot))
    silent = [name for name, power in consumers if power is None]
    power = float_sum(power for _, power in consumers if power is not None)
    missing = [
        f"voltage or capacity of `{battery.name}`" for battery in present if battery.energy is None
    ]
    common = {battery.name for battery in robot.common_source}
    source = [battery for battery in present if battery.name in common]
    voltages, capacities = {b.voltage for b in source}, [b.capacity for b in source]
    voltage = voltages.pop() if len(voltages) == 1 else None
    known = [capacity for capacity in capacities if capacity is not None]
    capacity = float_sum(known) if known and len(known) == len(source) else None
    has_standby = bool(source) and energy is not None and power > 0.0 and not silent
    if len(present) > 1 and not source:
        missing.append(
            "which modules each battery supplies"
            if robot.battery_connection
            else "whether the batteries are in parallel"
        )
    if force <= 0.0:
        missing.append("the rolling resistance of the wheels")
    if any(wheel.driven for wheel in robot.wheels):
        missing.append("the efficiency of motors and gears")
    if silent:
        missing.append(f"the power of {_listed(silent)}")
    return Energy(
        batteries,
        robot.battery_connection,
        bool(source),
        voltage,
        capacity,
        energy,
        force,
        power,
        energy / power if has_standby and energy is not None else None,
        power / voltage if has_standby and voltage else None,
        tuple(missing),
    )


def _batteries(robot: Robot) -> Iterator[BatteryFacts]:
    for battery in robot.batteries:
        voltage, capacity = battery.voltage, battery.capacity
        present = battery.node is not None
        energy = voltage * capacity if voltage is not None and capacity is not None else None
        yield BatteryFacts(battery.name, battery.module, present, voltage, capacity, energy)


def _stated_powers(robot: Robot) -> Iterator[tuple[str, float | None]]:
    batteries = {battery.node for battery in robot.batteries}
    for sensor in robot.sensors:
        yield sensor.name, stated_number(sensor.properties, POWER)
    for bus in robot.buses:
        for node in bus.nodes:
            if node.name not in batteries:
                yield node.name, stated_number(node.properties, POWER)


def _listed(names: list[str]) -> str:
    shown = ", ".join(f"`{name}`" for name in names[:3])
    return f"{shown} and {len(names) - 3} more" if len(names) > 3 else shown
