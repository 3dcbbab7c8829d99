"""A person drives a robot with a keyboard or a joystick; begin at ``console``."""
