"""The simulated device of each protocol: built-in ones, and those of other packages."""

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
    """Makes the simulated device of a node.

    A node of an unknown protocol becomes a ``ForeignDevice``, which only sends its frames.  Raises
    ``DiagnosticError`` (``bus-driver-unknown``) if the class that a package offers cannot be used.
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
