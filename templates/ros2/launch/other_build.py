def folder_of(model):
    share = os.path.dirname(os.path.dirname(os.path.abspath(model)))
    if not os.path.isfile(os.path.join(share, "config", "base_driver.yaml")):
        raise RuntimeError(f"model is {model}; expected ros2/config/model.json of a build")
    return share
