"""``make bench``: figures that are held to a bound.

A module in this package that has ``figures() -> Iterable[Figure]`` is found and
run, in alphabetical order; nothing else is to be edited to add one.  ``GROUP = "long"``
makes it a part of ``make bench-long`` instead.
"""
