"""Finds contradictions in the files of any robot.

Readers, one for each format, turn files to descriptions of the robot, sections of parameters and
launched nodes, whose values have source spans (``audit_facts``).  Each rule (``audit_rules``) is a
function that compares them and reports contradictions.
"""
