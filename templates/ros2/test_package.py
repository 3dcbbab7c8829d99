"""The launch files and parameter files of this package can be read: ``colcon test``."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import yaml

PACKAGE = Path(__file__).parents[1]


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("launch/*.py")), ids=lambda path: path.name)
def test_a_launch_file_describes_a_launch(path):
    """Each argument has a description and each default value is one of its choices."""
    pytest.importorskip("launch_ros")
    spec = spec_from_file_location("launch_file", path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    # % if settings.launch
    if path.name in [
        # % for own in settings.launch
        {{ own.name | quoted }},
        # % endfor
    ]:
        return  # from the robot's file
    # % endif
    for argument in module.generate_launch_description().get_launch_arguments():
        assert argument.description
        default = "".join(part.text for part in argument.default_value)
        assert not argument.choices or default in argument.choices


@pytest.mark.parametrize("path", sorted(PACKAGE.glob("config/*.yaml")), ids=lambda path: path.name)
def test_a_parameter_file_is_yaml(path):
    """The file has entries."""
    assert yaml.safe_load(path.read_text(encoding="utf-8"))
