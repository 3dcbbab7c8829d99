"""The command line ``thorvaldc``."""
