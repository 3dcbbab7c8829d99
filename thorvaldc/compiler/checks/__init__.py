"""Checks of the model of a whole robot: tip-over, slopes, load capacity, free motions, purpose.

May import: ``robot_settings`` and the rooms below.  Begin with ``robot_checks.py``;
``mobility_checks.py`` has the checks of motion.
"""
