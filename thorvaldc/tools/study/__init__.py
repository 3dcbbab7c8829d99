"""Runs studies: samples designs, evaluates each design, keeps the results."""
