"""Runs the cases of tests/diagnostics that audit the folder or file ``entry``."""

from __future__ import annotations

from thorvaldc.tools.audit.audit_run import audit

COMMANDS = {"audit": lambda case, entry: audit([entry]).report}
