"""The library of modules for its readers: checks a module type, and describes it.

May import: ``result`` and the rooms below.  Begin with ``module_description.py`` (facts of a module
type) and ``library_check.py`` (``thorvaldc modules check``).
"""
