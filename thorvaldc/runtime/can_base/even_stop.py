"""Stops the wheels of the other buses together with those of a lost bus, so that the robot turns
as little as possible.

The drives of a lost bus receive nothing.  They run on at their speed v until their watchdogs act,
after the time W, and then brake with the deceleration a.  If the wheels of the other side braked at
once, the robot would turn by about v W / track: by 22 deg at 0.8 m/s, out of its crop row:

    speed  v ____________                     ____________
             |\\          \\                                \\
             | \\          \\  lost side                      \\  both sides
           0 |__\\__________\\___               ______________\\___
             0   other side  W + v / a         0            W + v / a

The other wheels therefore keep their speed for the time W, and then brake, too.  The robot needs no
more time and room than the wheels of the lost bus need anyway, which is what it promises for a dead
driver.  Other reactions turn or delay it more: a ramp that ends at the same time turns
the robot by half of the angle, and one that ends after the same path takes longer.

It is done only where the driver knows that the bus is lost: its interface is gone or off the bus.
A silent bus may be one whose drives have lost their power and brake; then all other wheels brake at
once.  So they do if the lost wheels are on both sides, because then the robot does not turn.
"""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.model.stopping import watchdog_time
from thorvaldc.model.swerve import yaw_per_metre
from thorvaldc.runtime.can_base.bus_connection import BusConnection


def hold_time(connections: Sequence[BusConnection]) -> float:
    """Returns the time (s) for which the wheels of the remaining buses keep their speed.

    Returns 0 if the wheels have to brake at once: no bus is lost, or all are, or the robot does not
    turn, or the drives of the lost bus have no watchdog and never stop.
    """
    lost = [connection for connection in connections if connection.is_lost]
    if not lost or len(lost) == len(connections):
        return 0.0
    watchdogs = [watchdog_time(c.node) for connection in lost for c in connection.controllers]
    times = [time for time in watchdogs if time is not None]
    turns = yaw_per_metre(lost[0].robot, [connection.bus for connection in lost]) > 0.0
    return max(times, default=0.0) if turns and len(times) == len(watchdogs) else 0.0
