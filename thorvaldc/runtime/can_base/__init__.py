"""The robot's joints over its buses: frames, devices' drivers, and what guards them."""
