"""Simulated CAN buses with the devices of a robot, in virtual time or in real time.

A ``wire`` carries frames with arbitration; ``canopen_device`` is a node, and ``cia402_device`` and
``roboteq_device`` are drives on it; ``simulated_robot`` builds the buses of a model, and
``bus_server`` lets other programs take part.  The page docs/simulated-bus.md describes the bus.
Only the module ``python_can_plugin`` imports python-can.  Begin with ``simulated_robot``.
"""
