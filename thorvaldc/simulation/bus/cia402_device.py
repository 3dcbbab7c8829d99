"""A simulated CANopen drive with the device profile CiA 402, for one or more motors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from thorvaldc.can.canopen import NmtState
from thorvaldc.can.cia402 import DriveState
from thorvaldc.model import Actuator
from thorvaldc.model.bus import OBJECT_TYPES, FrameDefinition, Node
from thorvaldc.model.cia402_motors import FIRST_INDEX, STRIDE, motor_numbers
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.cia402_axis import Axis, AxisSettings
from thorvaldc.simulation.bus.device_description import DeviceDescription, commissioned_memory
from thorvaldc.simulation.bus.object_dictionary import ObjectDictionary
from thorvaldc.simulation.bus.pdo import EVENT_DRIVEN, Pdo, PdoSet
from thorvaldc.simulation.bus.simulated_motors import Encoder, MotorModel
from thorvaldc.simulation.bus.wire import Wire

if TYPE_CHECKING:
    from typing import Self

    from thorvaldc.simulation.bus.device_specification import DeviceSpecification

CONTROL_PERIOD = 0.002
"""Period of the control loop (s)."""
DEVICE_TYPE = 0x00020192
"""Value of object 0x1000 for a servo drive with the device profile 402."""
MOTION_ERROR = 0x20
"""Bit of the error register (object 0x1001) for a motion error."""
_UNUSED_CHANNEL = AxisSettings(1.0, 1024, 652.0, 652.0, 1.0, 1.0, 0.0)


class Cia402Drive(CanopenDevice):
    """A simulated CiA 402 drive, whose motors start in the state SWITCH ON DISABLED.

    ``received`` has the factory settings of the RPDOs, and ``sent`` has the factory settings of the
    TPDOs.  The drive adds the node id to the CAN identifiers in the factory settings.

    Object 0x6007 defines the reaction of the drive to a loss of the connection to the master.  The
    connection to the master is lost in three cases: a heartbeat that object 0x1016 defines is
    missing, the CAN controller is in bus-off, or the NMT state leaves OPERATIONAL while a motor is
    powered.

    ``numbers`` has the number of each motor in the object dictionary: the objects of motor 0 begin
    at 0x6000, those of motor 1 at 0x6800.  By default the motors are numbered in their order.

    ``control_period`` is the period of the control loop (s).  A longer period saves computing time
    in simulations of many hours.
    """

    control_period = CONTROL_PERIOD

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        node_id: int,
        description: DeviceDescription,
        axes: Sequence[tuple[AxisSettings, MotorModel]],
        *,
        numbers: Sequence[int] | None = None,
        received: Sequence[Pdo] = (),
        sent: Sequence[Pdo] = (),
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(
            name, wire, bitrate, node_id, description, seed=seed, nonvolatile=nonvolatile
        )
        self.axes = [Axis(settings, motor, self._report_error) for settings, motor in axes]
        self._numbers = tuple(range(len(axes)) if numbers is None else numbers)
        self._received = tuple(received)
        self._sent = tuple(sent)

    @classmethod
    def from_specification(cls, specification: DeviceSpecification) -> Self:
        node = specification.node
        axes = []
        for channel in node.channels:
            actuator = specification.actuator(channel.name)
            motor = specification.motor_of(actuator)
            if actuator is None:
                axes.append((_UNUSED_CHANNEL, motor))
            else:
                axes.append((_axis_settings(specification, actuator), motor))
        return cls(
            specification.name,
            specification.wire,
            specification.bus.bitrate,
            node.id,
            DeviceDescription.from_specification(specification, "CiA 402 drive", DEVICE_TYPE),
            axes,
            numbers=motor_numbers(specification.bus, node),
            received=_factory_pdos(specification.received, node),
            sent=_factory_pdos(specification.sent, node),
            seed=specification.seed,
            nonvolatile=commissioned_memory(specification),
        )

    def channel_motor(self, index: int) -> tuple[Encoder | None, MotorModel | None]:
        if index >= len(self.axes):
            return None, None
        return self.axes[index].encoder, self.axes[index].motor

    def add_objects(self, objects: ObjectDictionary) -> None:
        for number, axis in zip(self._numbers, self.axes, strict=True):
            axis.add_objects(objects, FIRST_INDEX + STRIDE * number)

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet:
        received, sent = (
            [pdo._replace(cob_id=pdo.cob_id + self.node_id) for pdo in pdos]
            for pdos in (self._received, self._sent)
        )
        return PdoSet(objects, received, sent, self.send)

    def initialised(self) -> None:
        for axis in self.axes:
            if axis.states.state is DriveState.NOT_READY:
                axis.start(self.now)
        self.every(lambda: self.control_period, self._tick, first=self.control_period)

    def stop(self) -> None:
        super().stop()
        for axis in self.axes:
            axis.stop(self.now)

    def nmt_state_changed(self, state: NmtState) -> None:
        if state is NmtState.INITIALISING:
            for axis in self.axes:
                axis.power_stage_off(self.now)
        elif state is not NmtState.OPERATIONAL:
            self._connection_lost()

    def communication_error(self) -> None:
        self._connection_lost()
        super().communication_error()

    def _connection_lost(self) -> None:
        for axis in self.axes:
            axis.connection_lost()

    def _tick(self) -> None:
        now = self.now
        for axis in self.axes:
            axis.tick(now, self.control_period)
        if self.pdos is not None and self.state is NmtState.OPERATIONAL:
            self.pdos.tick(now)

    def _report_error(self, code: int) -> None:
        if code:
            self.emergency(code, MOTION_ERROR)
        elif all(axis.error_code == 0 for axis in self.axes):
            self.emergency(0)


def _axis_settings(specification: DeviceSpecification, actuator: Actuator) -> AxisSettings:
    joint = specification.robot.joint(actuator.joint)
    steering = actuator.role == "steering"
    # A quadrature encoder has four counts per encoder pulse.  The gear ratio converts encoder
    # counts at the motor to encoder counts at the joint.
    counts_per_radian = 4.0 * actuator.encoder_ppr * actuator.gear_ratio / math.tau
    return AxisSettings(
        actuator.gear_ratio,
        actuator.encoder_ppr,
        counts_per_radian,
        counts_per_radian,
        actuator.max_velocity,
        actuator.max_acceleration,
        actuator.max_torque,
        joint.lower if steering else None,
        joint.upper if steering else None,
        brake=actuator.brake is not None,
        zero=actuator.encoder_offset,
    )


def _factory_pdos(frames: Sequence[FrameDefinition], node: Node) -> list[Pdo]:
    return [
        Pdo(
            frame.pdo,
            frame.cob_id - node.id,
            EVENT_DRIVEN,
            tuple(
                (index, subindex, OBJECT_TYPES[kind][1]) for index, subindex, kind in frame.mapping
            ),
        )
        for frame in frames
        if frame.pdo is not None
    ]
