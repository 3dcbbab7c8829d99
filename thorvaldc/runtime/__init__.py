"""What a robot's computer runs: the base driver, its calculators and the bases that it moves.

Begin with ``driver`` (one control cycle from twists to commands and odometry).  ``driven_robot``
adds arming, services and time, and is the same for `run` and for the ROS 2 node; ``run_session``
is a run from start to rest.  ``calculators`` convert twists and joint states; ``can_base`` is the
base on CAN buses, and ``base_interface`` what every base has.  Loads no compiler and no numpy.
"""
