"""Facts about a robot: the derived numbers that a designer or a user of the robot asks for.

``robot_facts`` computes them from the model, and ``facts_document`` converts them to JSON values.
"""

from thorvaldc.model.facts.facts_document import facts_document
from thorvaldc.model.facts.robot_facts import RobotFacts, robot_facts

__all__ = ["RobotFacts", "facts_document", "robot_facts"]
