"""What programs and libraries make of the MJCF and URDF of a robot: the table of docs/mjcf.md.

``python -m tests.conformance.reader_table`` writes the table. A cell with a number is compared with
what MuJoCo reads, to this difference (relative above 1); a cell with a text says what the reader
lacks. ``test_readers.py`` checks both.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tests.outside_tools import ENVIRONMENTS
from thorvaldc.diagnostics.text_layout import markdown_table

PAGE = Path(__file__).parents[2] / "docs" / "mjcf.md"
BEGIN, END = "<!-- made by tests/conformance/reader_table.py -->\n", "<!-- end -->\n"
MJCF, URDF = "mjcf/robot.xml", "urdf/robot.urdf"
COLUMNS = ("mass", "inertia", "poses", "contacts", "friction", "actuators", "springs", "limits")
NONE, TAKEN, ABSENT = "not read", "MuJoCo's", "not in URDF"


@dataclass(frozen=True)
class Reader:
    """A reader in the environment ``.venv/<environment>``, started by ``program``.

    ``cells`` has the tolerance or the lack of each column, ``notes`` what else a cell says.
    """

    name: str
    environment: str
    program: str
    cells: tuple[float | str, ...]
    file: str = MJCF
    notes: str = ""

    @property
    def python(self) -> Path:
        return ENVIRONMENTS / self.environment / "bin/python"


EXACT, SINGLE = 1e-9, 2e-6  # 64-bit numbers; 32-bit numbers
READERS = (
    Reader("MuJoCo 3.14", "dart", "mujoco_reader.py", (EXACT,) * 8),
    Reader("MuJoCo 4.0", "warp", "mujoco_reader.py", (EXACT,) * 8),
    Reader(
        "dm_control 1.0.50",
        "pinocchio",
        "dm_control_reader.py",
        (EXACT,) * 8,
        notes="its `mjcf.from_path` refuses names with `/`: robots with a name space",
    ),
    Reader(
        "MuJoCo Warp 4.0",
        "warp",
        "warp_reader.py",
        (SINGLE, SINGLE, SINGLE, TAKEN, TAKEN, TAKEN, SINGLE, TAKEN),
        notes="drives 1 s straight and on the spot as MuJoCo, to 0.1 mm",
    ),
    Reader(
        "Newton 1.8",
        "warp",
        "newton_reader.py",
        (SINGLE,) * 8,
        notes="actuators have no names",
    ),
    Reader(
        "Drake 1.51",
        "drake",
        "drake_mjcf_reader.py",
        (EXACT, EXACT, EXACT, EXACT, EXACT, EXACT, NONE, EXACT),
        notes="reads OBJ meshes only: read with OBJ files in place of STL; has no `intvelocity`",
    ),
    Reader(
        "Pinocchio 4.1",
        "pinocchio",
        "pinocchio_reader.py",
        (EXACT, EXACT, EXACT, EXACT, NONE, NONE, NONE, EXACT),
    ),
    Reader(
        "mujoco-usd-converter 0.8",
        "usd",
        "usd_reader.py",
        (SINGLE, SINGLE, SINGLE, SINGLE, "without tyres", "`MjcActuator`", SINGLE, SINGLE),
        notes="loses the tyres (ellipsoids)",
    ),
    Reader(
        "DART 6.20",
        "dart",
        "dart_urdf_reader.py",
        (EXACT, EXACT, EXACT, EXACT, ABSENT, ABSENT, ABSENT, EXACT),
        file=URDF,
        notes="1 kg more for `base_link` without the option below",
    ),
)


def table() -> str:
    rows = [["reader", *COLUMNS, "note"]]
    for reader in READERS:
        kind = "URDF" if reader.file == URDF else "MJCF"
        cells = [cell if isinstance(cell, str) else f"{cell:.0e}" for cell in reader.cells]
        rows.append([f"{reader.name}, {kind}", *cells, reader.notes])
    return "\n".join(markdown_table(rows))


def with_table(page: str) -> str:
    """The page with the present table."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table()}\n\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
