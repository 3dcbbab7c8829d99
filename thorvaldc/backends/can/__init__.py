"""The build target `can`: files for programs that use, set up or check the robot's CAN buses.

The page docs/canmap.md describes the files of the `can` target. The backend reads all node ids,
COB-IDs, scalings, object dictionary entries and response times from the model.
"""

from __future__ import annotations

from collections.abc import Iterable

from thorvaldc.backends import Backend
from thorvaldc.backends.can import bring_up, budget, c_header, canmap, dbc, dcf, ros2_canopen
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Robot


class Can(Backend):
    name = "can"
    summary = "CAN map, DBC, DCF of each node, C header, load of the bus, set-up of interfaces"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        files = {"can/canmap.json": canmap.canmap_text(robot).encode()}
        if not robot.buses:
            return files
        alone = len(robot.buses) == 1
        for bus in robot.buses:
            path = "can/robot.dbc" if alone else f"can/{bus.name}.dbc"
            text = dbc.dbc_text(bus)
            # ASCII is part of the encoding, and its codec is much faster.
            files[path] = text.encode("ascii" if text.isascii() else dbc.ENCODING, "replace")
            for node in bus.described_nodes:
                files[f"can/dcf/{node.name}.dcf"] = dcf.dcf_text(bus, node).encode("ascii")
            if bus.described_nodes:
                path = "can/bus.yml" if alone else f"can/{bus.name}.bus.yml"
                files[path] = ros2_canopen.bus_yml(bus).encode()
        files["can/robot_can.h"] = c_header.header_text(robot).encode("ascii", "replace")
        files["can/budget.json"] = budget.budget_json(robot).encode()
        files["can/budget.md"] = budget.budget_table(robot).encode()
        files["can/bring_up.sh"] = bring_up.script(robot).encode()
        return files

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        for bus in robot.buses:
            yield from dbc.lost_texts(bus)
