"""Deterministic simulation of missions with random faults; docs/chaos.md describes it."""
