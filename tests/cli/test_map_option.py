"""``--map``: the grid map beside a log, in every command that reads one."""

import numpy as np
import pytest

from pmcl.logs import LidarScans, RobotLog
from pmcl.maps import OccupancyGrid

COMMANDS = {
    "calibrate": ["calibrate", "LOG", "-o", "OUT.nc"],
    "localize": ["localize", "LOG", "--method", "prior", "-o", "OUT.nc"],
    "criticize": ["criticize", "LOG", "-o", "OUT.html"],
    "compare": ["compare", "LOG", "-o", "OUT.html"],
}


@pytest.fixture
def folder(tmp_path):
    cells = np.zeros((40, 40), dtype=np.uint8)
    cells[0] = 1
    OccupancyGrid(cells, 0.1).write(tmp_path / "hall.yaml")
    scans = LidarScans(np.full((5, 3), 1.0), np.array([-1.0, 0.0, 1.0]), 0.0, 10.0, np.zeros(3))
    RobotLog.build(
        time=np.arange(5.0), odometry=np.zeros((5, 3)), lidars={"": scans}, start_mean=[9.0, 1.0, 0.0],
        start_std=[0.1, 0.1, 0.1], warn=False,
    ).write(tmp_path / "log.nc")  # fmt: skip
    return tmp_path


def words(folder, command, *more):
    named = {"LOG": folder / "log.nc", "OUT.nc": folder / "out.nc", "OUT.html": folder / "out.html"}
    return [named.get(word, word) for word in COMMANDS[command]] + list(more)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_map_is_read_and_goes_with_the_log(command, folder, refused):
    # The log begins beyond the edge of the map: only a command that lays one on the other can tell.
    line = refused(*words(folder, command, "--map", folder / "hall.yaml"))
    assert "expected start_mean on the grid map (x 0 to 4 m, y 0 to 4 m), got (9, 1) m" in line
    assert {path.name for path in folder.iterdir()} == {"hall.yaml", "hall.pgm", "log.nc"}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_map_that_is_none_is_refused_in_one_line(command, folder, refused):
    assert "no such file" in refused(*words(folder, command, "--map", folder / "gone.yaml")).lower()
    line = refused(*words(folder, command, "--map", folder / "hall.pgm"))
    assert f"{folder / 'hall.pgm'}: expected a map's YAML file" in line


@pytest.mark.parametrize("command", COMMANDS)
def test_the_output_is_not_the_map(command, folder, refused):
    before = (folder / "hall.yaml").read_bytes()
    arguments = words(folder, command, "--map", folder / "hall.yaml")
    arguments[arguments.index("-o") + 1] = folder / "hall.yaml"
    assert "hall.yaml" in refused(*arguments)
    assert (folder / "hall.yaml").read_bytes() == before
