"""Starts the base driver of thorvaldc, or the guard of the joints in another program."""

import os
import sys

ENVIRONMENTS = ("/opt/thorvaldc-env", os.path.expanduser("~/thorvaldc-env"))
"""Where thorvaldc may be, beside the Python of ROS 2."""

try:
    from thorvaldc.ros.base_driver import guard, main
except ModuleNotFoundError as error:
    if not str(error.name).startswith("thorvaldc"):
        raise
    for environment in ENVIRONMENTS:
        python = os.path.join(environment, "bin", "python")
        if sys.prefix not in ENVIRONMENTS and os.access(python, os.X_OK):
            os.execv(python, [python, *sys.argv])
    sys.exit(
        f"The Python of this ROS 2, {sys.executable}, has no package thorvaldc; "
        "the README of thorvald_4wd4ws_wide says how to install it."
    )

__all__ = ["guard", "main"]

if __name__ == "__main__":
    sys.exit(main())
