"""A simulated CANopen device of which only the EDS is known."""

from __future__ import annotations

from thorvaldc.can.canopen import NmtState
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.object_dictionary import ObjectDictionary
from thorvaldc.simulation.bus.process_data import Pdo, PdoSet

PERIOD = 0.005
"""Time (s) after which the device sends the event-driven TPDOs that are due."""


class DescribedDevice(CanopenDevice):
    """A simulated device with the objects of its EDS and the PDOs of its module.

    Received values are kept in their objects; no other object ever changes.
    """

    device_name = "CANopen device"

    def make_pdos(self, objects: ObjectDictionary) -> PdoSet:
        specification = self.specification
        of_node = specification.node.id - self.node_id
        received, sent = (
            [Pdo.of_frame(frame, of_node) for frame in frames if frame.pdo is not None]
            for frames in (specification.received, specification.sent)
        )
        return PdoSet(objects, received, sent, self.send)

    def initialised(self) -> None:
        self.every(lambda: PERIOD, self._tick, first=PERIOD)

    def _tick(self) -> None:
        if self.pdos is not None and self.state is NmtState.OPERATIONAL:
            self.pdos.tick(self.now)
