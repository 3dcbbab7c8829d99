"""Identity, supported services and non-volatile memory of a simulated CANopen device."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from thorvaldc.can import lss
from thorvaldc.model.bus_quirks import Quirk
from thorvaldc.simulation.bus.object_dictionary import parameter_name

if TYPE_CHECKING:
    from thorvaldc.simulation.bus.device_specification import DeviceSpecification

NODE_ID, PARAMETERS = "node_id", "parameters"
"""Keys of the values in non-volatile memory."""


@dataclass(frozen=True, slots=True)
class DeviceDescription:
    """Identity and supported services of a simulated CANopen device.

    * ``serial``: serial number, or ``None`` for a device without serial number and without LSS.
    * ``heartbeat_period``: period of the heartbeat (s).
    * ``bitrates``: supported bitrates (bit/s).
    * ``operational_at_start``: true if the device enters OPERATIONAL without an NMT command.
    * ``quirks``: deviations from the default behaviour.
    """

    device_type: int = 0
    vendor: int = 0
    product: int = 0
    revision: int = 0
    serial: int | None = None
    name: str = ""
    hardware: str = "1.0"
    software: str = "1.0"
    heartbeat_period: float = 0.1
    bitrates: tuple[int, ...] = tuple(lss.BITRATES.values())
    operational_at_start: bool = False
    quirks: frozenset[Quirk] = frozenset()

    @classmethod
    def from_specification(
        cls, specification: DeviceSpecification, name: str, device_type: int = 0
    ) -> DeviceDescription:
        """Returns the description of a node of a robot.

        ``device_type`` applies if the node does not have a device type.
        """
        node = specification.node
        is_clone = specification.name != node.name
        serial = None if is_clone else _serial_number(node.serial)
        if serial is None and node.lss:
            # The robot file may omit the serial number.  The computed serial number is the same in
            # every run and different for each device.
            serial = zlib.crc32(f"{specification.robot.name}/{specification.name}".encode())
        factory_state = specification.delivered and node.lss
        return cls(
            device_type=node.device_type or device_type,
            vendor=node.vendor_id or 0,
            product=node.product_code or 0,
            revision=node.revision_number or 0,
            serial=serial if node.lss else None,
            name=name,
            heartbeat_period=0.0 if factory_state else specification.heartbeat_period,
            bitrates=node.bitrates or tuple(lss.BITRATES.values()),
            quirks=specification.quirks,
        )


def _serial_number(text: str | None) -> int | None:
    try:
        return None if text is None else int(text, 0) & 0xFFFFFFFF
    except ValueError:
        return None


def commissioned_memory(specification: DeviceSpecification) -> dict[str, Any]:
    """Returns the contents of the non-volatile memory of a commissioned node.

    The memory contains the node id and the parameter values of the CAN map.  A device in the
    factory state has no parameter values.  A device in the factory state with LSS also has no node
    id.
    """
    node = specification.node
    without_id = specification.delivered and node.lss
    parameters = {
        parameter_name(entry.index, entry.subindex): entry.value
        for entry in node.objects
        if entry.access == "rw" and entry.value is not None
    }
    return {
        NODE_ID: lss.UNCONFIGURED if without_id else node.id,
        PARAMETERS: {} if specification.delivered else parameters,
        **specification.nonvolatile,
    }
