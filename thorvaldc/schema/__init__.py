"""The JSON Schemas of the documents: the definition of their shape."""

from thorvaldc.schema.documents import KINDS, Kind, bundle, inlined, schema_text

__all__ = ["KINDS", "Kind", "bundle", "inlined", "schema_text"]
