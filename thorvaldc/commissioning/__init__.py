"""Commissioning of the CANopen nodes on a robot's bus: scan, plan, flash and verify.

The commissioning sets the node id and the parameter values of each node on a CAN bus.  The page
docs/commissioning.md describes the procedure.  The commissioning uses a ``CanInterface`` to a
simulated or real bus.  The commissioning was never tested on physical hardware.
"""
