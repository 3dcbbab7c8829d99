"""Builds the CAN buses of a robot from its CAN devices.

A CAN bus in the robot model has nodes with node ids, and CAN frames with signals.  The section
`can` of a module document defines the CAN frames of the module.  Expressions in the section `can`
can use the node id of the device and the parameters of the connected motors.  The Python module
`bus_checks` checks each CAN bus.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from thorvaldc.can.canopen import HEARTBEAT, NMT, SYNC, NmtCommand
from thorvaldc.compiler.bus.bus_checks import LOAD_WARNING, check_bus, late_frames
from thorvaldc.compiler.bus.device_frames import heartbeat
from thorvaldc.compiler.bus.device_sections import (
    MASTER,
    MASTER_HEARTBEAT_PERIOD,
    MASTER_ID,
    BusSpec,
    Device,
    Placed,
    Wire,
)
from thorvaldc.compiler.bus.foreign_devices import foreign_devices
from thorvaldc.compiler.bus.id_checks import check_serials
from thorvaldc.compiler.bus.lock_file import Lock
from thorvaldc.compiler.bus.node_ids import assign_ids
from thorvaldc.compiler.bus.stopping_distance import master_heartbeat_period
from thorvaldc.compiler.bus.wiring_checks import check_wiring
from thorvaldc.compiler.source import node as source
from thorvaldc.diagnostics import Report
from thorvaldc.model import Actuator, Bus, FrameDefinition, Signal
from thorvaldc.model.bus_timing import bus_load, frame_response_times

__all__ = ["BusSpec", "Device", "Wire", "build_buses", "connect_actuators"]

# Bitrates (bit/s) of CiA 301 that are higher than the default bitrate.  If the robot file sets no
# bitrate for a CAN bus and the default bitrate is too slow, the compiler tries higher bitrates.
FASTER = (800_000, 1_000_000)

NMT_COMMANDS = tuple((command.value, command.name.lower()) for command in NmtCommand)


def build_buses(
    devices: Sequence[Device],
    specs: Sequence[BusSpec],
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
    check_wiring(present, actuators, report)
    others = foreign_devices(foreign, specs, report)
    placed = (
        assign_ids(present, others, specs, sync_period, lock or {}, report, watchdog=watchdog)
        + others
    )
    if not placed:
        return ()
    check_serials(placed, report)
    return tuple(
        _build_bus(spec, [p for p in placed if p.bus == spec.name], sync_period, watchdog, report)
        for spec in specs
    )


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


def _is_present(device: Device, report: Report) -> bool:
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
    spec: BusSpec,
    placed: Sequence[Placed],
    sync_period: float,
    watchdog: float,
    report: Report,
) -> Bus:
    heartbeat_period = MASTER_HEARTBEAT_PERIOD
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
    check_bus(bus, placed, report)
    return bus


def _timed(bus: Bus) -> Bus:
    """Returns the CAN bus with its bus load and the worst-case response times of its CAN frames.

    If two CAN frames have the same identifier, the response times are undefined, and the CAN bus is
    returned unchanged.  The Python module ``bus_checks`` reports duplicate identifiers of CAN
    frames.
    """
    if len({frame.cob_id for frame in bus.frames}) < len(bus.frames):
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
        if faster_bus.load <= LOAD_WARNING and not late_frames(faster_bus):
            break
        if all(not node.bitrates or bitrate in node.bitrates for node in bus.nodes):
            faster_bus = _timed(replace(bus, bitrate=bitrate))
    if faster_bus is not bus and not late_frames(faster_bus):
        reason = f"use {100 * bus.load:.0f} % of"
        if late_frames(bus):
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
    spec: BusSpec, placed: Sequence[Placed], sync_period: float, heartbeat_period: float
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
    yield heartbeat(MASTER, HEARTBEAT + MASTER_ID, MASTER, nodes, heartbeat_period, spec.span)
