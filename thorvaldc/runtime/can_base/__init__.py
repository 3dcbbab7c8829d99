"""The base of a robot on its CAN buses: drivers of the nodes, state machine, watchdogs, relay."""
