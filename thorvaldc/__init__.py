"""thorvaldc: a declarative compiler for modular robots."""

__version__ = "0.1.0"
