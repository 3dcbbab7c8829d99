"""Settings of a robot document beside its modules: driver, twist sources, ROS names, calibration.

May import: ``hardware`` and the rooms below.  Begin with ``driver_settings.py``;
``robot_sections.py`` has the short sections.
"""
