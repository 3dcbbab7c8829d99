"""Simulation of robots: runs and scenarios, and their results.

``physics`` has the simulated bases, ``records`` reads and writes recorded runs, ``pictures`` draws
plots, videos and web pages, ``bus`` simulates CAN devices, ``vectorised`` computes many robots
at a time, ``gym`` has the Gymnasium environment.
"""
