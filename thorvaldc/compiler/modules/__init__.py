"""Builds the model of a robot from the robot document and the module types."""
