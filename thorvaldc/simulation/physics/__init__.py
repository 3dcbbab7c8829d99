"""Simulated bases, which take joint commands and return joint states, as the base on a bus does.

``sim_base`` has the bases without MuJoCo: ideal joints, and wheels that roll without slip.
``mujoco_base`` drives in a ``mujoco_scene``, with the motors of ``drive_servos``; ``scenario_base``
adds faults, noise, ground zones and ice.  ``mjcf_reader`` reads MJCF files of others.
Begin with ``sim_base`` and ``mujoco_base``.
"""
