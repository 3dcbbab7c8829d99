"""Replays recorded runs without physics; begin at ``replay``."""
