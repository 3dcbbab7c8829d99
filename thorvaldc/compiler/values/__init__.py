"""Values of the entries of a document: numbers in SI, texts, vectors and poses, with their errors.

May import: ``source``.  Begin with ``value_reader.py``; ``dimension_hints.py`` and
``plausible_numbers.py`` explain wrong and missing units.
"""
