"""Shows frames, load and nodes of a CAN bus, and sends nothing; begin at ``bus_monitor``."""
