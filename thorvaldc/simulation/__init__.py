"""Simulates runs and scenarios of robots and computes the results.

The subpackages:

* ``physics``: simulated bases.
* ``records``: reading and writing of recorded runs.
* ``pictures``: plots, videos and web pages.
* ``bus``: simulated CAN devices.
* ``vectorised``: computations for many robots at a time.
* ``gym``: Gymnasium environment.
"""
