"""A drive after CiA 402 on CANopen, with one motor or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from thorvaldc.can.cia402 import DriveState
from thorvaldc.simulation.bus.canopen_device import CanopenDevice, NmtState, Profile
from thorvaldc.simulation.bus.cia402_axis import Axis, AxisSettings
from thorvaldc.simulation.bus.object_dictionary import ObjectDictionary
from thorvaldc.simulation.bus.pdo import Pdo, PdoSet
from thorvaldc.simulation.bus.simulated_motors import MotorModel
from thorvaldc.simulation.bus.wire import Wire

CONTROL_PERIOD = 0.002
"""s"""
STRIDE = 0x800
"""From the objects of one motor to those of the next."""
DEVICE_TYPE = 0x00020192
"""Object 0x1000 of a servo drive: profile 402."""
MOTION_ERROR = 0x20


class Cia402Drive(CanopenDevice):
    """Starts in SWITCH ON DISABLED, whatever was before.

    ``received`` and ``sent`` are its PDOs as delivered, their identifiers without the node
    id.  What it does when the master is lost (a heartbeat of 0x1016 missing, bus-off, or
    taken out of OPERATIONAL while it is powered) is 0x6007's to say.
    """

    def __init__(
        self,
        name: str,
        wire: Wire,
        bitrate: int,
        node_id: int,
        profile: Profile,
        axes: Sequence[tuple[AxisSettings, MotorModel]],
        *,
        received: Sequence[Pdo] = (),
        sent: Sequence[Pdo] = (),
        seed: int = 0,
        nonvolatile: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(name, wire, bitrate, node_id, profile, seed=seed, nonvolatile=nonvolatile)
        self.axes = [Axis(settings, motor, self._told) for settings, motor in axes]
        self._received = tuple(received)
        self._sent = tuple(sent)

    def build(self, objects: ObjectDictionary) -> None:
        for place, axis in enumerate(self.axes):
            axis.build(objects, 0x6000 + STRIDE * place)

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet:
        received, sent = (
            [pdo._replace(cob_id=pdo.cob_id + self.node_id) for pdo in pdos]
            for pdos in (self._received, self._sent)
        )
        return PdoSet(objects, received, sent, self.send)

    def ready(self) -> None:
        for axis in self.axes:
            if axis.states.state is DriveState.NOT_READY:
                axis.start(self.now)
        self.every(lambda: CONTROL_PERIOD, self._tick, first=CONTROL_PERIOD)

    def stop(self) -> None:
        super().stop()
        for axis in self.axes:
            axis.stop(self.now)

    def entered(self, state: NmtState) -> None:
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
            axis.tick(now, CONTROL_PERIOD)
        if self.pdos is not None and self.state is NmtState.OPERATIONAL:
            self.pdos.tick(now)

    def _told(self, code: int) -> None:
        if code:
            self.emergency(code, MOTION_ERROR)
        elif all(axis.error_code == 0 for axis in self.axes):
            self.emergency(0)
