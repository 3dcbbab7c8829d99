"""Simulates runs and scenarios of robots and computes the results.

The subpackages:

* ``physics``: simulated bases.
* ``records``: reading and writing of recorded runs.
* ``pictures``: plots, pictures and videos.
* ``web_viewer``: the robot in 3D in a web browser.
* ``bus``: simulated CAN devices.
* ``vectorised``: computations for many robots at a time.
* ``gym``: Gymnasium environment.
"""
