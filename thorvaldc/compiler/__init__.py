"""Turns a ``robot.yaml`` into the model of the robot, a report, and the files of the targets.

Begin with ``pipeline.py``, which runs the stages in order; ``elaborate.py`` makes the model, and
``result.py`` says what a compilation returns.  ``catalogue.py`` checks and describes the module
types of the library; ``scaffolding.py`` makes new files.  May import ``backends``, ``schema``,
``runtime``, ``can``, ``model`` and ``diagnostics``, but no simulator and no bus.  The rooms
inside have an order of their own, from ``source`` (text to nodes) up to ``scenario`` and
``output``: see the contract "Rooms of the compiler" in ``pyproject.toml``.
"""
