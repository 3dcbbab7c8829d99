"""The table of rules.  A rule is a function that compares what the readers have found."""

from __future__ import annotations

from collections.abc import Callable

from thorvaldc.diagnostics import Report
from thorvaldc.tools.audit import (
    body_rules,
    file_rules,
    footprint_rules,
    launched_tree,
    limit_rules,
    name_rules,
    transform_rules,
    twist_rules,
    wheel_rules,
)
from thorvaldc.tools.audit.audit_facts import Evidence

RULES: tuple[Callable[[Evidence, Report], None], ...] = (
    wheel_rules.check_wheel_radii,
    wheel_rules.check_wheel_separations,
    name_rules.check_joint_names,
    transform_rules.check_frames,
    transform_rules.check_transform_owners,
    transform_rules.check_state_publishers,
    twist_rules.check_stamps,
    twist_rules.check_speeds,
    twist_rules.check_wheel_speeds,
    limit_rules.check_command_limits,
    limit_rules.check_descriptions_agree,
    footprint_rules.check_footprints_agree,
    footprint_rules.check_footprints_cover,
    body_rules.check_masses,
    body_rules.check_inertias,
    body_rules.check_densities,
    body_rules.check_lengths,
    body_rules.check_angles,
    launched_tree.check_launched_files,
    file_rules.check_controller_sections,
    file_rules.check_node_ids,
)
