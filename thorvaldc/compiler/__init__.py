"""The compiler reads robot, fleet and scenario files and builds the model.

The module ``pipeline`` runs the stages of the compiler.
"""
