"""Links, joints, wheels, motors, sensors and batteries of the modules, and of the whole robot.

May import: ``modules``, ``shapes`` and the rooms below.  Begin with ``hardware_reader.py`` (one
module in its own frame), then ``robot_parts.py`` (all modules in place, and coupled joints).
"""
