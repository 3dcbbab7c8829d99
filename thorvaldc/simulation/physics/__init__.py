"""Simulated bases, which take joint commands and return joint states, as the base on a bus does.

``mujoco_base`` has wheels on the ground (``rolling_radii``, ``ground_zones``), motors
(``drive_servos``, ``motors_without_power``) and the errors of wheels and encoders
(``wheel_errors``); ``rolling_base`` rolls without slip.  Begin with ``sim_base`` and
``scenario_base``.
"""
