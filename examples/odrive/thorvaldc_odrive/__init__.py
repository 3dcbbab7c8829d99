"""ODrive motor controllers (CANSimple) for thorvaldc: driver and simulated device."""
