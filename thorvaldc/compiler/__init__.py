"""The compiler reads robot, fleet and scenario files and builds the model.

Start reading in the module ``pipeline``.
"""
