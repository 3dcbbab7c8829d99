"""What a compilation returns: the model, the report, and the files that were read.

May import: ``bus``, ``modules`` and the rooms below.  Begin with ``compilation.py``.
``acceptances.py`` has the warnings that a document accepts; ``consequences.py`` drops diagnostics
that follow from another one.
"""
