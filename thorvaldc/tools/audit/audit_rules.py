"""The table of rules.  A rule is a function that compares what the readers have found."""

from __future__ import annotations

from collections.abc import Callable

from thorvaldc.diagnostics import Report
from thorvaldc.tools.audit import name_rules, wheel_rules
from thorvaldc.tools.audit.audit_facts import Evidence

RULES: tuple[Callable[[Evidence, Report], None], ...] = (
    wheel_rules.check_wheel_radii,
    wheel_rules.check_wheel_separations,
    name_rules.check_joint_names,
)
