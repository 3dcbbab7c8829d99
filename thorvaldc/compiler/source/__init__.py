"""Reads YAML into nodes with source spans, and quantities with units into SI values.

May import: no other room of the compiler.  Begin with ``node.py`` (the tree of a document), then
``reader.py`` (text to nodes), ``units.py`` (``650 mm``) and ``expressions.py`` (``${width / 2}``).
"""
