"""Driving by hand: from the keyboard of a terminal or a joystick, whatever the robot is."""
