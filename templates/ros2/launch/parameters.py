def parameters(*name):
    """Return the parameters in a file of the folder config, with the names of the robot."""
    return ParameterFile([os.path.join(SHARE, "config", ""), *name, ".yaml"], allow_substs=True)


