"""Commands of tools run as those of the core."""

from tests.cli.conftest import thorvaldc

__all__ = ["thorvaldc"]
