"""Injects faults into a simulated robot on its buses, and measures how its driver reacts."""
