"""JK BMS batteries on the CAN bus for thorvaldc: driver and simulated device."""
