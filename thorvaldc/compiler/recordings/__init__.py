"""Recorded twists and joint states of a drive: CSV files and ROS bags.

May import: ``source``.  Begin with ``twist_log_reader.py`` (a scenario that repeats a recorded
drive) and ``ros_bag.py`` (messages and topic names of a bag).
"""
