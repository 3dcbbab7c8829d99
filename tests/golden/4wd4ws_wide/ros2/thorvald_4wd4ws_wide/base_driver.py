"""Starts the base driver of thorvaldc, or the guard of the joints in another program."""

import sys

try:
    from thorvaldc.ros.base_driver import guard, main
except ModuleNotFoundError as error:
    if not str(error.name).startswith("thorvaldc"):
        raise
    sys.exit(
        f"The Python of this ROS 2, {sys.executable}, has no package thorvaldc; "
        "the README of thorvald_4wd4ws_wide says how to install it."
    )

__all__ = ["guard", "main"]

if __name__ == "__main__":
    main()
