"""JSON Schemas of the documents: the single definition of their structure."""

from thorvaldc.schema.documents import KINDS, Kind, bundle, inlined, schema_text

__all__ = ["KINDS", "Kind", "bundle", "inlined", "schema_text"]
