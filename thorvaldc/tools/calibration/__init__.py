"""Estimates wheel radii and steering offsets from a joint log; begin at ``self_calibration``."""
