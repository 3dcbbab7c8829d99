"""Controls the motors of a robot base over one or more CAN buses."""
