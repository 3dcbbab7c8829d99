"""A loop in which an operator, a person or a page, drives a robot; begin at ``teleop_loop``."""
