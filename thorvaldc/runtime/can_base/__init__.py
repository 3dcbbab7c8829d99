"""Controls the motors of a robot's base over its CAN buses."""
