"""``python -m thorvaldc``."""

from thorvaldc.cli.main import run

run()
