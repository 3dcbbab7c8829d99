"""CAN frames, interfaces to buses, and the messages of CANopen; knows no robot.

Begin with ``frame`` (frames and the protocol of an interface) and ``open_interface`` (an interface
by its name); ``canopen`` has the objects, commands and CiA 402 states, ``sdo`` and ``lss`` the
messages of these services.  The drivers of a robot's nodes are in ``runtime.can_base``, the
simulated nodes in ``simulation.bus``, the services that configure nodes in ``commissioning``.
"""
