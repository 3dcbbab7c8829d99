"""Commissioning: scans a robot's bus, plans and writes addresses and values, and verifies them.

See docs/commissioning.md.  All of it uses a ``CanInterface``, in virtual or in real time.
None of it was ever tried on physical hardware.
"""
