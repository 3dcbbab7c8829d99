"""The statics of a robot: joint tree, mass matrix, wheel contacts and standing pose."""
