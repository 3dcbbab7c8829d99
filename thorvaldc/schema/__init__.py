"""JSON Schemas that define the structure of each kind of document."""

from thorvaldc.schema.documents import KINDS, Kind, bundle, inlined, schema_text

__all__ = ["KINDS", "Kind", "bundle", "inlined", "schema_text"]
