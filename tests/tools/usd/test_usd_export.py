"""The OpenUSD file of each example, read by OpenUSD without the converter, against the model."""

from __future__ import annotations

import json
import math
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.child_process import ChildProcess  # noqa: F401
from tests.outside_tools import path_of_usd_python
from thorvaldc.compiler.pipeline import load
from thorvaldc.model import Robot
from thorvaldc.model.spatial import quat_to_matrix
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.tools.usd.usd_export import _files, _rigid_bodies

ROOT = Path(__file__).resolve().parents[3]
READER = Path(__file__).with_name("usd_reader.py")
NAMES = sorted(path.parent.name for path in (ROOT / "examples").glob("*/robot.yaml"))
slow = pytest.mark.slow
