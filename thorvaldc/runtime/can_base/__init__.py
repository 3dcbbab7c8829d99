"""The base on CAN buses: reads and commands the motors of a robot.

Begin with ``can_base``, the control cycle.  ``base_state_machine`` has the states from start to
motion, with emergency stop and safety stop; ``stop_ladder`` stops motors that do not obey;
``node_watchdog`` detects lost heartbeats and reads values of nodes back.  ``bus_connection`` sends
and receives the frames of one bus, ``signal_codec`` converts them to SI, and a driver for each
kind of motor controller (``roboteq_driver``, ``cia402_driver``) extends ``motor_controller``.
"""
