"""The sensors of the modules in a MuJoCo scene; begin with ``sensor_suite``."""
