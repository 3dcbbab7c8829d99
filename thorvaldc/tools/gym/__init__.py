"""The Gymnasium environment of a robot."""
