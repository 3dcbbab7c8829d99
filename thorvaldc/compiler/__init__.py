"""The compiler: from robot, fleet and scenario files to the model.  Start at ``pipeline``."""
