"""Simulates runs and scenarios of robots and computes the results.

The rooms, from the robot to what is drawn of it:

* ``physics``: simulated bases, in MuJoCo, rolling without slip, or with ideal joints.
* ``bus``: simulated CAN devices.
* ``records``: reading and writing of recorded runs.
* ``pictures``: plots, pictures and videos; ``web_viewer``: the robot in 3D in a web browser.

The simulation may import every room below it, and no command and no tool.  Begin with
``simulation_run`` for a run and ``control_loop`` for one tick; ``scenario_run`` adds what a
scenario expects.
"""
