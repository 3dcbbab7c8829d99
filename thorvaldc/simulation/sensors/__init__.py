"""The sensors of the modules in a MuJoCo scene: lidars, IMUs, GNSS receivers and cameras.

Begin with ``sensor_suite``.  ``lidar``, ``imu``, ``gnss`` and ``camera`` measure; ``ros_messages``
describes the measurements as ROS 2 messages, for the node and for records.
"""
