"""Runs the cases of tests/diagnostics that ask what an OpenUSD file of a robot leaves out."""

from __future__ import annotations

from thorvaldc.compiler.pipeline import load
from thorvaldc.tools.usd.usd_export import unsupported

COMMANDS = {"usd": lambda case, entry: list(unsupported(load(entry)))}
