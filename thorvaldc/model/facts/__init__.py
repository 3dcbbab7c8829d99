"""Facts about a robot: the derived numbers that a designer or a user of the robot asks for.

Begin with ``robot_facts``, which computes them from the model; ``facts_document`` converts them to
JSON values.  The compiler needs single facts, so this file imports none.
"""
