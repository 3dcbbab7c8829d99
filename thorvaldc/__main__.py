"""``python -m thorvaldc``."""

from thorvaldc.cli.main import run

if __name__ == "__main__":
    run()
