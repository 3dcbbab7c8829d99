"""Collects the CAN devices of a robot and its wired motors, and builds the CAN buses from them.

A CAN bus in the robot model has nodes with node ids, and CAN frames with signals.  The section
`can` of a module document defines the CAN frames of the module.  Expressions in the section `can`
can use the node id of the device and the parameters of the connected motors.  The Python module
`bus_checks` checks each CAN bus.

A foreign device is a device on a CAN bus of the robot that is not a module of the robot.  The base
driver relays only the CAN frames that the robot file declares for a foreign device.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import replace
from typing import Any, NamedTuple

from thorvaldc.can.canopen import HEARTBEAT, NMT, SYNC, NmtCommand
from thorvaldc.compiler.bus import bus_checks, device_frames
from thorvaldc.compiler.bus import device_sections as sections
from thorvaldc.compiler.bus.node_ids import Lock, assign_ids, bus_name
from thorvaldc.compiler.bus.stopping_distance import master_heartbeat_period
from thorvaldc.compiler.modules.library import Library
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.source import node as source
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Actuator, Bus, FrameDefinition, Joint, Node, Signal
from thorvaldc.model.bus import CANOPEN, MASTER
from thorvaldc.model.bus_timing import bus_load, frame_response_times
from thorvaldc.schema import inlined

DEFAULT_BUS = "main"


MAX_REMEMBERED = 256
"""Largest number of robots whose buses ``remembered_buses`` keeps."""

_remembered: ContextVar[dict[Any, tuple[Bus, ...]] | None] = ContextVar("buses", default=None)


@contextlib.contextmanager
def remembered_buses() -> Iterator[None]:
    """Within this context, the buses of equal devices are built once.

    The context is for many compilations of one robot, in which other values than those of its
    devices change.  Buses with diagnostics are built each time.
    """
    token = _remembered.set({})
    try:
        yield
    finally:
        _remembered.reset(token)


class Wiring(NamedTuple):
    """Collects the CAN devices of a robot and the motors on the channels of motor controllers.

    - ``document``: robot document.
    - ``resolver``: resolver of the references to motors.
    - ``scope``: names and values for expressions in the robot document.
    - ``actuators``: actuators of the model, by name.
    - ``joints``: joints of the model, by name.
    - ``lock``: node ids of the last build, from the lock file.
    """

    document: source.Node
    resolver: Resolver
    scope: Scope
    actuators: dict[str, Actuator]
    joints: dict[str, Joint]
    lock: Lock
    report: Report

    def buses(self, robot: Instance, period: float, watchdog: float = math.inf) -> tuple[Bus, ...]:
        """Returns the CAN buses of a robot.

        - ``robot``: root of the tree of module instances.
        - ``period``: control cycle of the base driver in s.
        - ``watchdog``: longest heartbeat consumer time of a drive in s.
        """
        devices: list[sections.Device] = []
        for leaf in robot.leaves():
            can = leaf.type.document.get("can") if leaf.type is not None else None
            if can is not None:
                devices.append(self._device(leaf, can))
        specs, actuators = self._specs(), list(self.actuators.values())
        foreign = self.document.get("foreign_devices")
        remembered, key = _remembered.get(), None
        if remembered is not None and foreign is None:
            inputs = tuple(map(_inputs, devices))
            key = (inputs, *specs, *actuators, *self.lock.items(), period, watchdog)
            if key in remembered:
                return remembered[key]
        number = len(self.report)
        buses = build_buses(
            devices,
            specs,
            actuators,
            period,
            self.report,
            foreign=foreign,
            lock=self.lock,
            watchdog=watchdog,
        )
        if remembered is not None and key is not None and len(self.report) == number:
            if len(remembered) >= MAX_REMEMBERED:
                remembered.clear()
            remembered[key] = buses
        return buses

    def _specs(self) -> list[sections.BusSpec]:
        named = self.document.get("name") or self.document
        unstated = {DEFAULT_BUS: source.Node({}, named.span)}
        schema = inlined("robot")["properties"]["buses"]["additionalProperties"]
        specs = []
        for name, entry in (entries(self.document.get("buses")) or unstated).items():
            bitrate = round(Section(entry, schema, self.scope)["bitrate"])
            specs.append(
                sections.BusSpec(name, bitrate, entry.where, entry.get("bitrate") is not None)
            )
        return specs

    def _device(self, leaf: Instance, can: source.Node) -> sections.Device:
        wires: list[sections.Wire] = []
        for channel, node in leaf.wiring.items():
            wire = self._wire(leaf, channel, node)
            if wire is not None:
                wires.append(wire)
        document = leaf.type.document if leaf.type is not None else can
        return sections.Device(
            path=leaf.path,
            name=name_prefix(leaf.path),
            can=can,
            channels=document.get("channels"),
            wires=tuple(wires),
            address=leaf.can,
            scope=leaf.scope,
            span=leaf.span,
        )

    def _wire(self, leaf: Instance, channel: str, node: source.Node) -> sections.Wire | None:
        inside = leaf.parent if leaf.parent is not None else leaf
        reference = inside.scope.text(node)
        if not reference:
            return None
        motor = self.resolver.references.find_motor(inside, reference, node)
        if motor is None:
            return None
        actuator = self.actuators.get(f"{name_prefix(motor[0].path)}_{motor[1]}")
        if actuator is None:
            return None
        joint = self.joints[actuator.joint]
        return sections.Wire(channel, actuator, joint.lower, joint.upper, node.where)


def _inputs(device: sections.Device) -> Hashable:
    """Returns all of a device that its nodes and frames depend on.

    The expressions in the section `can` use only the parameters of the module, and values that the
    module document computes from them.
    """
    values = tuple(tuple(v) if isinstance(v, list) else v for v in device.scope.parameter_values())
    address = None if device.address is None else repr(device.address)
    return device.path, device.scope.module, values, device.wires, address, device.span


# Bitrates (bit/s) of CiA 301 that are higher than the default bitrate.  If the robot file sets no
# bitrate for a CAN bus and the default bitrate is too slow, the compiler tries higher bitrates.
FASTER = (800_000, 1_000_000)

NMT_COMMANDS = tuple((command.value, command.name.lower()) for command in NmtCommand)


def build_buses(
    devices: Sequence[sections.Device],
    specs: Sequence[sections.BusSpec],
    actuators: Sequence[Actuator],
    sync_period: float,
    report: Report,
    *,
    foreign: source.Node | None = None,
    lock: Lock | None = None,
    watchdog: float = math.inf,
) -> tuple[Bus, ...]:
    """Builds and checks the CAN buses of a robot with their nodes, CAN frames and signals.

    - ``devices``: module instances with a section `can`.
    - ``specs``: buses in the order of the robot file.  A CAN device without a bus name belongs to
      the first bus.
    - ``actuators``: motors of the robot.
    - ``sync_period``: control cycle in s.
    - ``foreign``: section `foreign_devices` of the robot file.
    - ``lock``: node ids of the last build, from the lock file.
    - ``watchdog``: longest heartbeat consumer time of a drive in s.

    Returns an empty tuple if the robot has no CAN devices, or if the bitrate of a bus is not
    positive.
    """
    for spec in specs:
        if spec.bitrate <= 0:
            report.add(
                "can-bitrate",
                f"the bus `{spec.name}` has {spec.bitrate} bit/s; a bitrate is positive",
                spec.span,
                hint="write it as in `500 kbit/s`",
            )
    if not specs or any(spec.bitrate <= 0 for spec in specs):
        return ()
    present = [device for device in devices if _is_present(device, report)]
    bus_checks.check_wiring(present, actuators, report)
    others = foreign_devices(foreign, specs, report)
    placed = (
        assign_ids(present, others, specs, sync_period, lock or {}, report, watchdog=watchdog)
        + others
    )
    if not placed:
        return ()
    bus_checks.check_serials(placed, report)
    buses = tuple(
        _build_bus(spec, [p for p in placed if p.bus == spec.name], sync_period, watchdog, report)
        for spec in specs
    )
    bus_checks.check_buses_differ(buses, report)
    return buses


def connect_actuators(actuators: Sequence[Actuator], buses: Sequence[Bus]) -> tuple[Actuator, ...]:
    """Returns the actuators with the names of their motor controllers and controller channels.

    The attributes ``node`` and ``channel`` of an actuator contain the name of the motor controller
    and the name of the channel.  Actuators that no motor controller drives are returned unchanged.
    """
    drives = {
        channel.actuator: (node.name, channel.name)
        for bus in buses
        for node in bus.nodes
        for channel in node.channels
        if channel.actuator is not None
    }
    return tuple(
        replace(a, node=drives[a.name][0], channel=drives[a.name][1]) if a.name in drives else a
        for a in actuators
    )


def _is_present(device: sections.Device, report: Report) -> bool:
    """Returns whether a module of the robot contains a CAN device.

    The key `when` in the section `can` can depend on the parameters of the module.  For example, an
    empty battery enclosure contains no CAN device.
    """
    present = device.scope.boolean(device.can.get("when"), True)
    if not present and device.address is not None:
        report.add(
            "can-address-unused",
            f"`{device.path}` has an address, but with these parameters it contains no device",
            device.address.where,
            hint="leave `can` out, or change the parameters so that there is a device",
        )
    return present


# -- the bus ------------------------------------------------------------------------


def _build_bus(
    spec: sections.BusSpec,
    placed: Sequence[sections.Placed],
    sync_period: float,
    watchdog: float,
    report: Report,
) -> Bus:
    heartbeat_period = sections.MASTER_HEARTBEAT_PERIOD
    if math.isfinite(watchdog):
        times = [device.node.heartbeat_consumer_time for device in placed]
        shortest = min((time for time in times if time is not None), default=math.inf)
        heartbeat_period = master_heartbeat_period(shortest, sync_period)
    frames = list(_master_frames(spec, placed, sync_period, heartbeat_period))
    for device in placed:
        frames.extend(device.frames)
    bus = _timed(
        Bus(
            spec.name,
            spec.bitrate,
            sync_period,
            tuple(device.node for device in placed),
            tuple(frames),
            spec.span,
        )
    )
    if not spec.stated:
        bus = _fast_enough(bus, report)
    bus_checks.check_bus(bus, placed, report)
    return bus


def _timed(bus: Bus) -> Bus:
    """Returns the CAN bus with its bus load and the worst-case response times of its CAN frames.

    If two CAN frames have the same identifier, the response times are undefined, and the CAN bus is
    returned unchanged.  The Python module ``bus_checks`` reports duplicate identifiers of CAN
    frames.
    """
    if len({frame.key for frame in bus.frames}) < len(bus.frames):
        return bus
    times = frame_response_times(bus)
    timed = tuple(replace(frame, response_time=times[frame.name]) for frame in bus.frames)
    return replace(bus, frames=timed, load=bus_load(bus))


def _fast_enough(bus: Bus, report: Report) -> Bus:
    """Increases the bitrate of a CAN bus if the bus load is too high or deadlines are missed.

    Only the bitrate of a CAN bus without a bitrate in the robot file can be increased.
    """
    faster_bus = bus
    for bitrate in FASTER:
        if faster_bus.load <= bus_checks.LOAD_WARNING and not bus_checks.late_frames(faster_bus):
            break
        if all(not node.bitrates or bitrate in node.bitrates for node in bus.nodes):
            faster_bus = _timed(replace(bus, bitrate=bitrate))
    if faster_bus is not bus and not bus_checks.late_frames(faster_bus):
        reason = f"use {100 * bus.load:.0f} % of"
        if bus_checks.late_frames(bus):
            reason = "arrive too late at"
        report.add(
            "can-bitrate-chosen",
            f"the bus `{bus.name}` gets {faster_bus.bitrate / 1000:g} kbit/s: "
            f"its frames would {reason} {bus.bitrate / 1000:g} kbit/s",
            bus.span,
            hint=f"state a bitrate: `buses: {{{bus.name}: {{bitrate: ..}}}}`",
        )
    return faster_bus


def _master_frames(
    spec: sections.BusSpec,
    placed: Sequence[sections.Placed],
    sync_period: float,
    heartbeat_period: float,
) -> Iterator[FrameDefinition]:
    """Yields the CAN frames NMT, SYNC and heartbeat, which the master sends to all CANopen nodes.

    On a bus without CANopen nodes, the master sends no NMT, SYNC and heartbeat frames.
    """
    nodes = tuple(d.node.name for d in placed if d.node.is_canopen)
    if not nodes:
        return
    yield FrameDefinition(
        "nmt",
        NMT,
        "nmt",
        MASTER,
        nodes,
        2,
        None,
        None,
        (Signal("nmt_command", 0, 8, choices=NMT_COMMANDS), Signal("nmt_node", 8, 8)),
        spec.span,
        "Network management: change the state of one node, or of all (0).",
    )
    yield FrameDefinition(
        "sync",
        SYNC,
        "sync",
        MASTER,
        nodes,
        0,
        sync_period,
        sync_period,
        (),
        spec.span,
        "The control cycle's beat, after its commands.",
    )
    yield device_frames.heartbeat(
        MASTER,
        HEARTBEAT + sections.MASTER_ID,
        MASTER,
        nodes,
        heartbeat_period,
        spec.span,
    )


# -- foreign devices ---------------------------------------------------------------------

PROTOCOL = "foreign"


def foreign_devices(
    section: source.Node | None, specs: Sequence[sections.BusSpec], report: Report
) -> list[sections.Placed]:
    """Returns the foreign CAN devices of a robot with the CAN frames that the base driver relays.

    - ``section``: section `foreign_devices` of the robot file.
    """
    scope = Scope(None, {}, Library(), report, None)
    devices = []
    for name, device in entries(section).items():
        id_node = device.get("id")
        node_id = sections.whole_number(id_node)
        services = device.get("canopen")
        if services is not None and services.value and node_id is None:
            report.add(
                "missing-key",
                f"`{name}` has CANopen services, but no node id for their frames",
                services.where,
                hint="add `id: ...`",
            )
            services = None
        frames = [
            *_relayed(name, device, scope),
            *device_frames.standard_frames(
                name, node_id or 0, services, device_frames.HEARTBEAT_PERIOD
            ),
        ]
        span = id_node.span if id_node is not None else device.where
        devices.append(
            sections.Placed(
                name,
                bus_name(device.get("bus"), specs, report),
                span,
                span,
                _node(name, node_id, device.where),
                tuple(frames),
                device.where,
            )
        )
    return devices


def _node(name: str, node_id: int | None, span: Span) -> Node:
    id_space = CANOPEN if node_id is not None else ""
    return Node(name, "", PROTOCOL, node_id or 0, id_space, None, None, (), (), span)


def _relayed(name: str, device: source.Node, scope: Scope) -> Iterator[FrameDefinition]:
    device_schema = inlined("robot")["properties"]["foreign_devices"]["additionalProperties"]
    schema = device_schema["properties"]["frames"]["additionalProperties"]
    for key, node in entries(device.get("frames")).items():
        known = device_frames.identifier(f"`{key}` of `{name}`", node, scope)
        length = sections.whole_number(node.get("length"))
        if known is None:
            continue
        to_device = scope.text(node.get("direction")) == "command"
        yield FrameDefinition(
            f"{name}_{key}",
            known[0],
            "relay",
            MASTER if to_device else name,
            (name,) if to_device else (MASTER,),
            8 if length is None else length,
            None,
            None,
            (),
            node.where,
            scope.text(node.get("description")),
            device_frames.minimum_interval(Section(node, schema, scope)),
            extended=known[1],
        )
