"""Checks the shape of a document against its JSON Schema.

May import: ``source``.  Begin with ``document_check.py``.
"""
