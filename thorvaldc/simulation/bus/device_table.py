"""Creates the simulated device of a node, from built-in classes or classes of other packages."""

from __future__ import annotations

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.plugins import PluginFailure, PluginTable
from thorvaldc.simulation.bus.battery_and_io_devices import ForeignDevice
from thorvaldc.simulation.bus.device_specification import DeviceSpecification
from thorvaldc.simulation.bus.simulated_device import SimulatedDevice

_PACKAGE = "thorvaldc.simulation.bus"

SIMULATED_DEVICES: PluginTable[SimulatedDevice] = PluginTable(
    "thorvaldc.simulated_devices",
    SimulatedDevice,
    {
        "cia402": f"{_PACKAGE}.cia402_device:Cia402Drive",
        "thorvald_roboteq": f"{_PACKAGE}.roboteq_device:RoboteqController",
        "thorvald_roboteq_propulsion": f"{_PACKAGE}.roboteq_device:RoboteqController",
        "thorvald_kc_battery": f"{_PACKAGE}.battery_and_io_devices:KcBattery",
        "thorvald_io": f"{_PACKAGE}.battery_and_io_devices:IoBoard",
    },
)
"""By ``Node.protocol``.  docs/simulated-bus.md shows how a package adds a device."""


def create_device(specification: DeviceSpecification) -> SimulatedDevice:
    """Creates the simulated device of a CAN node.

    The protocol of the CAN node selects the class of the simulated device.  A CAN node with an
    unknown protocol becomes a ``ForeignDevice``.  Raises ``DiagnosticError``
    (``bus-driver-unknown``) if a class that another package provides is not a valid device class.
    """
    node = specification.node
    device = SIMULATED_DEVICES.load(node.protocol)
    if not isinstance(device, PluginFailure):
        return device.from_specification(specification)
    if device.unknown:
        return ForeignDevice.from_specification(specification)
    raise DiagnosticError(
        "bus-driver-unknown",
        f"the simulated device for `{node.protocol}` {device.reason}",
        node.span,
    )
