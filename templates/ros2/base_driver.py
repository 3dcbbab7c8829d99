"""Starts the base driver of thorvaldc."""

import sys

try:
    from thorvaldc.ros.base_driver import main
except ModuleNotFoundError as error:
    if not str(error.name).startswith("thorvaldc"):
        raise
    sys.exit(
        f"The Python of this ROS 2, {sys.executable}, has no package thorvaldc; "
        "the README of {{ package }} says how to install it."
    )

if __name__ == "__main__":
    main()
