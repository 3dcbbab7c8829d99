"""One list of rules over links and joints: of compiled robots, extras, and the files of others.

May import: ``shapes`` and the rooms below.  Begin with ``description_rules.py``.
"""
