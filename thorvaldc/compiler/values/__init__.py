"""Values of the entries of a document: numbers in SI, texts, vectors and poses, with their errors.

May import: ``source``, ``validation``.  Begin with ``value_reader.py`` (single values), then
``document_section.py`` (values as the schema describes them) and ``unit_file.py`` (``extends``).
"""
