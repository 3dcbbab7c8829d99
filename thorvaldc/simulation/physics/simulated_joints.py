"""The interface of a simulated base whose motors can lose their power."""

from __future__ import annotations

import abc

from thorvaldc.runtime.base_interface import BaseHandle


class SimulatedJoints(BaseHandle):
    """The joints of a simulated base.

    All motors have power at first.  A joint whose motor has no power does not follow its commands.
    It turns freely, against the back-driving torque of the motor and a closed brake.
    """

    @abc.abstractmethod
    def switch_motor(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        """Switches the power of a motor on or off at the time ``now`` (s).

        ``wheel`` is the index in ``Robot.wheels``.  ``steering``: the motor of the steering joint;
        otherwise that of the spin joint.  Nothing changes for a motor that is on or off already.
        """
