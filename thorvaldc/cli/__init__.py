"""The command line program ``thorvaldc``."""
