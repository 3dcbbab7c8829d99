"""Commissioning: what is on a robot's bus is found, planned, written and verified.

See docs/commissioning.md.  Everything works on a ``CanInterface``, in virtual time as by the clock.
None of it was ever tried on physical hardware.
"""
