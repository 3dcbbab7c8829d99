"""Identity, abilities and non-volatile memory of a CANopen device, from a node of a robot's bus."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from thorvaldc.can import lss
from thorvaldc.simulation.bus.object_dictionary import parameter_name

if TYPE_CHECKING:
    from thorvaldc.simulation.bus.device_specification import DeviceSpecification

NODE_ID, PARAMETERS = "node_id", "parameters"
"""Keys of non-volatile memory."""


@dataclass(frozen=True, slots=True)
class DeviceDescription:
    """Identity and abilities of a CANopen device.

    ``serial`` ``None``: the device has no serial number and no LSS.  ``bitrates`` (bit/s):
    the supported ones.  ``operational_at_start``: it does not wait for the NMT start command.
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

    @classmethod
    def from_specification(
        cls, specification: DeviceSpecification, name: str, device_type: int = 0
    ) -> DeviceDescription:
        """The description of a node; ``device_type`` applies if the node states none."""
        node = specification.node
        is_clone = specification.name != node.name
        serial = None if is_clone else _serial_number(node.serial)
        if serial is None and node.lss:
            # The robot file need not state it: the same in every run, another for each device.
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
        )


def _serial_number(text: str | None) -> int | None:
    try:
        return None if text is None else int(text, 0) & 0xFFFFFFFF
    except ValueError:
        return None


def commissioned_memory(specification: DeviceSpecification) -> dict[str, Any]:
    """Returns the non-volatile memory of a node: its id and the values of the CAN map.

    ``delivered``: no values; no id either if LSS can set it.
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
