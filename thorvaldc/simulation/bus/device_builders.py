"""A simulated device for each node of a robot's bus, by the node's protocol."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.can import lss as lss_layer
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.bus import OBJECT_TYPES, Bus, FrameDefinition, Node
from thorvaldc.simulation.bus.battery_and_io_devices import (
    BATTERY_FRAMES,
    ForeignDevice,
    ForeignFrame,
    IoBoard,
    KcBattery,
)
from thorvaldc.simulation.bus.canopen_device import NODE_ID, PARAMETERS, NmtState, Profile
from thorvaldc.simulation.bus.cia402_axis import AxisSettings
from thorvaldc.simulation.bus.cia402_device import DEVICE_TYPE, Cia402Drive
from thorvaldc.simulation.bus.pdo import EVENT_DRIVEN, Pdo
from thorvaldc.simulation.bus.roboteq_channel import ChannelSettings
from thorvaldc.simulation.bus.roboteq_device import RoboteqController
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice
from thorvaldc.simulation.bus.simulated_motors import IdealMotor, MotorModel
from thorvaldc.simulation.bus.wire import Wire

MASTER = "master"
_TYPES = {name: bits for name, (_, bits) in OBJECT_TYPES.items()}


@dataclass
class Build:
    """What a device is made from.

    ``motor`` gives the model of an actuator's motor.  ``delivered``: as it comes from its
    maker, with neither id nor parameters where these can be written over the bus.
    ``nonvolatile`` overrides what it keeps without power (``node_id``, ``bitrate``...).
    """

    robot: Robot
    bus: Bus
    node: Node
    wire: Wire
    motor: Callable[[Actuator], MotorModel]
    name: str = ""
    seed: int = 0
    delivered: bool = False
    nonvolatile: Mapping[str, Any] = field(default_factory=dict)

    @property
    def sent(self) -> list[FrameDefinition]:
        return [f for f in self.bus.frames if f.producer == self.node.name]

    @property
    def received(self) -> list[FrameDefinition]:
        return [
            f for f in self.bus.frames if f.producer == MASTER and f.consumers == (self.node.name,)
        ]

    def period(self, cob_id: int, default: float) -> float:
        """s between two frames of that identifier."""
        found = (f.period for f in self.sent if f.cob_id == cob_id)
        return next((p for p in found if p is not None), default)

    @property
    def heartbeat_period(self) -> float:
        return self.period(0x700 + self.node.id, 0.0)

    def property(self, name: str) -> Any:
        return dict(self.node.properties).get(name)

    def actuator(self, channel: str) -> Actuator | None:
        name = next(c.actuator for c in self.node.channels if c.name == channel)
        return next((a for a in self.robot.actuators if a.name == name), None)

    def motor_of(self, actuator: Actuator | None) -> MotorModel:
        """A channel without a motor has one that nothing hangs on."""
        return IdealMotor(1.0, 1.0) if actuator is None else self.motor(actuator)

    def common(self) -> dict[str, Any]:
        return {"seed": self.seed, "nonvolatile": self.nonvolatile}


def build(given: Build) -> SimulatedDevice:
    """The device of a node; of an unknown protocol, one that sends what the node sends."""
    return BUILDERS.get(given.node.protocol, _foreign)(given)


def _profile(given: Build, name: str, device_type: int = 0) -> Profile:
    node = given.node
    serial = _serial(node.serial) if given.name == node.name else None
    if serial is None and node.lss:
        # It has one, whoever knows it: the same in every run, another for each device.
        serial = zlib.crc32(f"{given.robot.name}/{given.name}".encode())
    return Profile(
        device_type=node.device_type or device_type,
        vendor=node.vendor_id or 0,
        product=node.product_code or 0,
        revision=node.revision_number or 0,
        serial=serial if node.lss else None,
        name=name,
        heartbeat_period=0.0 if given.delivered and node.lss else given.heartbeat_period,
        bitrates=node.bitrates or tuple(lss_layer.BITRATES.values()),
    )


def _serial(text: str | None) -> int | None:
    try:
        return None if text is None else int(text, 0) & 0xFFFFFFFF
    except ValueError:
        return None


def _cia402(given: Build) -> SimulatedDevice:
    node = given.node
    axes: list[tuple[AxisSettings, MotorModel]] = []
    for channel in node.channels:
        actuator = given.actuator(channel.name)
        motor = given.motor_of(actuator)
        if actuator is None:
            axes.append((AxisSettings(1.0, 1024, 652.0, 652.0, 1.0, 1.0), motor))
            continue
        joint = given.robot.joint(actuator.joint)
        steering = actuator.role == "steering"
        counts = 4.0 * actuator.encoder_ppr * actuator.gear_ratio / math.tau
        axes.append(
            (
                AxisSettings(
                    actuator.gear_ratio,
                    actuator.encoder_ppr,
                    counts,
                    counts,
                    actuator.max_velocity,
                    actuator.max_acceleration,
                    actuator.max_torque,
                    joint.lower if steering else None,
                    joint.upper if steering else None,
                    brake=steering,
                    zero=actuator.encoder_offset,
                ),
                motor,
            )
        )
    parameters = {
        f"{entry.index:04x}.{entry.subindex:02x}": entry.value
        for entry in node.objects
        if entry.access == "rw" and entry.value is not None
    }
    fresh = given.delivered and node.lss
    nonvolatile = {
        NODE_ID: lss_layer.UNCONFIGURED if fresh else node.id,
        PARAMETERS: {} if given.delivered else parameters,
        **given.nonvolatile,
    }
    return Cia402Drive(
        given.name,
        given.wire,
        given.bus.bitrate,
        node.id,
        _profile(given, "CiA 402 drive", DEVICE_TYPE),
        axes,
        received=[_pdo(frame, node) for frame in given.received if frame.pdo is not None],
        sent=[_pdo(frame, node) for frame in given.sent if frame.pdo is not None],
        seed=given.seed,
        nonvolatile=nonvolatile,
    )


def _pdo(frame: FrameDefinition, node: Node) -> Pdo:
    mapping = tuple((index, sub, _TYPES[kind]) for index, sub, kind in frame.mapping)
    return Pdo(frame.pdo or 1, frame.cob_id - node.id, EVENT_DRIVEN, mapping)


def _roboteq(given: Build) -> SimulatedDevice:
    node = given.node
    channels = []
    home_angle = 0.0
    for channel in node.channels[:2]:
        actuator = given.actuator(channel.name)
        motor = given.motor_of(actuator)
        if actuator is not None and actuator.encoder_offset:
            home_angle = actuator.encoder_offset
        if actuator is None:
            settings = ChannelSettings(1.0, 1024, 3000.0, steering=channel.role == "steering")
        else:
            joint = given.robot.joint(actuator.joint)
            ends = [abs(end) for end in (joint.lower, joint.upper) if end is not None]
            settings = ChannelSettings(
                actuator.gear_ratio,
                actuator.encoder_ppr,
                actuator.motor_max_speed * 30.0 / math.pi,
                actuator.max_torque,
                max(ends, default=math.pi),
                actuator.role == "steering",
            )
        channels.append((settings, motor))
    return RoboteqController(
        given.name,
        given.wire,
        given.bus.bitrate,
        node.id,
        (channels[0], channels[1]),
        profile=_profile(given, "FBL2360"),
        cycle=given.period(0x180 + node.id, given.bus.sync_period),
        status_period=given.period(0x280 + node.id, 0.1),
        identity_period=given.period(0x480 + node.id, 1.0),
        version=_version(given.property("script_version")),
        controller_type=int(given.property("script_type") or 0),
        home_angle=home_angle,
        **given.common(),
    )


def _version(text: Any) -> tuple[int, int, int]:
    """That of the script which the robot's file wants; what is no version counts as 1.0.0."""
    parts = str(text).split(".")
    if len(parts) == 3 and all(part.isdigit() and int(part) < 256 for part in parts):
        return int(parts[0]), int(parts[1]), int(parts[2])
    return 1, 0, 0


def _battery(given: Build) -> SimulatedDevice:
    node = given.node
    battery = next((b for b in given.robot.batteries if b.node == node.name), None)
    properties = dict(battery.properties) if battery is not None else {}
    # Capacity is a charge, in the model in A s.
    charge = properties.get("capacity")
    return KcBattery(
        given.name,
        given.wire,
        given.bus.bitrate,
        node.id,
        voltage=float(properties.get("voltage") or 48.0),
        capacity=float(charge) / 3600.0 if charge else 70.0,
        period=given.period(BATTERY_FRAMES[0] + node.id, 0.1),
        **given.common(),
    )


def _io_board(given: Build) -> SimulatedDevice:
    relays = [bool(given.property(f"relay_{i}_at_start")) for i in range(2)]
    return IoBoard(
        given.name,
        given.wire,
        given.bus.bitrate,
        given.node.id,
        at_start=int(relays[0]) | int(relays[1]) << 1,
        period=given.period(0x180 + given.node.id, 0.1),
        **given.common(),
    )


def _foreign(given: Build) -> SimulatedDevice:
    sends = [
        ForeignFrame(
            frame.cob_id,
            frame.length,
            frame.period,
            bytes([NmtState.OPERATIONAL]) if frame.kind == "heartbeat" else None,
        )
        for frame in given.sent
        if frame.kind in ("pdo", "broadcast", "relay", "heartbeat")
    ]
    return ForeignDevice(
        given.name,
        given.wire,
        given.bus.bitrate,
        [frame.cob_id for frame in given.received if frame.kind in ("pdo", "broadcast", "relay")],
        sends,
        **given.common(),
    )


BUILDERS: dict[str, Callable[[Build], SimulatedDevice]] = {
    "cia402": _cia402,
    "thorvald_roboteq": _roboteq,
    "thorvald_roboteq_propulsion": _roboteq,
    "thorvald_kc_battery": _battery,
    "thorvald_io": _io_board,
}
"""By ``Node.protocol``: a device of another protocol is a function and a line here."""
