"""Odometry and metrics over arrays of ticks, equal in every digit to those of one tick.

Begin with ``deferred_odometry``, which a run uses; ADR 21 says why these copies exist.
"""
