"""How many particles a second a scan weighs: 10 000 particles, a grid of 400 x 400 cells of 5 cm, one thread."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.engine.compile import entry
from pmcl.engine.contract import reading_logpdf, scratch_rows
from pmcl.maps import OccupancyGrid
from pmcl.models import Lidar
from pmcl.simulations.lidar_room import lidar_room_map, simulate_lidar_room

PARTICLES = 10_000


@entry
def weigh_scan(sensor, states, logp, scratch):
    """Write the log density of the scan at row 5 from each state."""
    for i in range(logp.size):
        logp[i] = 0.0
    reading_logpdf(sensor, 5, states, states, logp, scratch)


def square_map() -> OccupancyGrid:
    """Return the simulated room in a grid of 400 x 400 cells."""
    room = lidar_room_map()
    cells = np.zeros((400, 400), dtype=np.uint8)
    cells[: room.cells.shape[0], : room.cells.shape[1]] = room.cells
    return OccupancyGrid(cells, room.resolution, room.origin)


def scan_and_states(model: str, beams: int, spread: str):
    """Return a table with one scan, and particles around the robot or all over the room."""
    log = simulate_lidar_room(10, 1, n_rays=beams, sensor=Lidar(max_beams=beams)).with_map(square_map())
    bound = Lidar(model=model, max_beams=beams).bind(log)
    table = bound.table(np.array([0.1, 0.1] if model == "likelihood-field" else [0.1, 0.1, 0.05, 0.1, 0.5]))
    rng = np.random.default_rng(1)
    if spread == "tracking":
        states = log.true_poses[5] + np.array([0.1, 0.1, 0.05]) * rng.standard_normal((PARTICLES, 3))
    else:
        states = rng.uniform((0.5, 0.5, -np.pi), (15.5, 11.5, np.pi), (PARTICLES, 3))
    return table, np.ascontiguousarray(states.T)


@pytest.mark.parametrize("spread", ["tracking", "everywhere"])
@pytest.mark.parametrize(("model", "beams"), [("likelihood-field", 60), ("likelihood-field", 360), ("beam", 60)])
def test_weighing_a_scan(benchmark, model, beams, spread):
    table, states = scan_and_states(model, beams, spread)
    logp = np.empty(PARTICLES)
    scratch = np.empty((int(scratch_rows(table)), PARTICLES))
    benchmark(weigh_scan, table, states, logp, scratch)
    benchmark.extra_info["particles_per_second"] = PARTICLES / benchmark.stats["min"]
