# % include "parameters.py"
def text_of(context, path):
    """Return the text of a file of this package with the names of the robot."""
    with open(os.path.join(SHARE, path), encoding="utf-8") as file:
        text = file.read().replace("$(find {{ package }})", SHARE)
    for name in ("name_prefix", "namespace"):
        text = text.replace(f"$(var {name})", LaunchConfiguration(name).perform(context))
    if LaunchConfiguration("driver_package", default="").perform(context):
        # Another package has started this build, which may not be installed.
        for scheme in ("package", "model"):
            text = text.replace(f"{scheme}://{{ package }}/", f"file://{SHARE}/")
    return text


def copies_of(context, *paths):
    """Return a folder with copies of files of this package that have the names of the robot."""
    folder = tempfile.mkdtemp(prefix="{{ package }}_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path in paths:
        text = text_of(context, path).replace('"../meshes/', f'"{SHARE}/meshes/')
        with open(os.path.join(folder, os.path.basename(path)), "w", encoding="utf-8") as file:
            file.write(text)
    return folder


def description_of(context, urdf):
    """Return the robot_description in a file of the folder urdf, with the names of the robot."""
    text, scene = text_of(context, f"urdf/{urdf}"), os.path.join(SHARE, "mjcf")
    if scene in text:
        text = text.replace(scene, copies_of(context, "mjcf/robot.xml", "mjcf/scene.xml"))
    return {"robot_description": ParameterValue(text, value_type=str)}


