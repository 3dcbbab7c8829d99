"""The file `bus.yml` for ros2_canopen, with the nodes, their DCFs and heartbeats.

`bus.yml` turns on heartbeats, because heartbeats are off by default in ros2_canopen. Without
heartbeats, the drives continue to run when the CANopen master stops working.
"""

from __future__ import annotations

from collections.abc import Iterator

from thorvaldc.backends.can.dcf import described
from thorvaldc.model.bus import Bus, Node

# Maps the unit of a CAN signal to the name of the physical quantity in ros2_canopen.
SCALES = {"rad": "pos", "rad/s": "vel"}
MODES = {1: "position_mode", 8: "position_mode", 3: "velocity_mode", 9: "velocity_mode"}
NO_TEXT = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")
MODE_OF_OPERATION, AXIS = 0x6060, 0x800


def bus_yml(bus: Bus) -> str:
    """Return the text of the file `bus.yml` for a CAN bus.

    The DCF of a CANopen node contains the settings of the node that are not in `bus.yml`.
    """
    lines = [
        "# Made by thorvaldc; changes are lost. Never tried on physical hardware.",
        "options:",
        '  dcf_path: "@BUS_CONFIG_PATH@"',
        "",
        "master:",
        f"  node_id: {bus.master_id}",
        '  driver: "ros2_canopen::MasterDriver"',
        '  package: "canopen_master_driver"',
        f"  baudrate: {bus.bitrate / 1000:g}",
        f"  sync_period: {round(bus.sync_period * 1e6)}",
        *_master_heartbeat(bus),
        "",
        "nodes:",
    ]
    for node in described(bus):
        lines += [f"  {_key(node.name)}:", *(f"    {line}" for line in _node(bus, node))]
    return "\n".join(lines) + "\n"


def _master_heartbeat(bus: Bus) -> Iterator[str]:
    period = _heartbeat(bus, "master")
    yield "  heartbeat_consumer: true"
    if period is None:
        return
    yield f"  heartbeat_producer: {_milliseconds(period)}"
    timeouts = [n.heartbeat_consumer_time for n in bus.nodes if n.heartbeat_consumer_time]
    if timeouts:
        yield f"  heartbeat_multiplier: {min(timeouts) / period:.6g}"


def _node(bus: Bus, node: Node) -> Iterator[str]:
    yield f"node_id: {node.id}"
    yield f'dcf: "dcf/{node.name}.dcf"'
    if node.is_cia402:
        yield 'driver: "ros2_canopen::Cia402Driver"'
        yield 'package: "canopen_402_driver"'
    else:
        yield 'driver: "ros2_canopen::ProxyDriver"'
        yield 'package: "canopen_proxy_driver"'
    yield f"period: {_milliseconds(bus.sync_period)}"
    if node.revision_number is not None:
        yield f"revision_number: {node.revision_number}"
    serial = next((e.value for e in node.objects if (e.index, e.subindex) == (0x1018, 4)), None)
    if serial is not None:
        yield f"serial_number: {serial}"
    period = _heartbeat(bus, node.name)
    if period is not None:
        yield f"heartbeat_producer: {_milliseconds(period)}"
        if node.heartbeat_timeout is not None:
            yield f"heartbeat_multiplier: {node.heartbeat_timeout / period:.6g}"
    watches = node.heartbeat_consumer_time is not None
    yield f"heartbeat_consumer: {'true' if watches else 'false'}"
    yield "mandatory: true"
    if node.is_cia402:
        yield from _axes(bus, node)


def _axes(bus: Bus, node: Node) -> Iterator[str]:
    """Yield the lines of `bus.yml` with the operating modes and scales of a CiA 402 drive.

    For a CiA 402 drive with several axes, `bus.yml` has a group of lines for each axis.
    """
    axes = [list(_axis(bus, node, number)) for number in range(len(node.channels))]
    if len(axes) == 1:
        yield from axes[0]
        return
    yield f"num_channels: {len(axes)}"
    yield f"channel_names: [{', '.join(f'{node.name}_{c.name}' for c in node.channels)}]"
    yield "channels:"
    for lines in axes:
        if not lines:
            yield "  - {}"
        for i, line in enumerate(lines):
            yield f"  {'- ' if i == 0 else '  '}{line}"


def _axis(bus: Bus, node: Node, number: int) -> Iterator[str]:
    objects = range(0x6000 + AXIS * number, 0x6000 + AXIS * (number + 1))
    for entry in node.objects:
        if entry.index == MODE_OF_OPERATION + AXIS * number and entry.value in MODES:
            yield f"{MODES[entry.value]}: {entry.value}"
    for frame in bus.frames:
        if not frame.mapping or node.name not in (frame.producer, *frame.consumers):
            continue
        if not any(index in objects for index, _, _ in frame.mapping):
            continue
        for signal in frame.signals:
            quantity = SCALES.get(signal.unit)
            if signal.joint is None or quantity is None:
                continue
            if frame.producer == node.name:
                yield f"scale_{quantity}_from_dev: {signal.scale!r}"
                if signal.offset:
                    yield f"offset_{quantity}_from_dev: {signal.offset!r}"
            else:
                yield f"scale_{quantity}_to_dev: {1 / signal.scale!r}"
                if signal.offset:
                    yield f"offset_{quantity}_to_dev: {-signal.offset / signal.scale!r}"


def _key(name: str) -> str:
    """Return the name as a YAML key, in quotes if YAML 1.1 would read the name as true or false.

    The program ros2_canopen reads YAML 1.1.
    """
    return f'"{name}"' if name in NO_TEXT else name


def _heartbeat(bus: Bus, producer: str) -> float | None:
    """Return the heartbeat period of a node or of the CANopen master in s.

    Returns ``None`` if the node or the CANopen master sends no heartbeat.
    """
    return next(
        (f.period for f in bus.frames if f.kind == "heartbeat" and f.producer == producer), None
    )


def _milliseconds(time: float) -> str:
    return f"{round(time * 1000, 3):g}"
