"""VESC motor controllers (CAN mode VESC) for thorvaldc: driver and simulated device."""
