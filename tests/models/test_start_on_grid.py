"""A start anywhere on a grid map is uniform over its free cells; places of effects lie on them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pmcl.engine import contract
from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import make_rng
from pmcl.maps import OccupancyGrid
from pmcl.models.effects.places import floor_places, has_floor
from pmcl.models.starts.belief import StartBelief

INF = math.inf
CELLS = np.array([[2, 2, 2, 2], [2, 1, 0, 0], [2, 0, 1, 2], [2, 0, 0, 2], [2, 2, 2, 2]], dtype=np.uint8)


def log_on(grid):
    return SimpleNamespace(
        walls=None, landmarks=None, grid_map=grid, where="log.nc", start_mean=np.zeros(3), start_std=np.full(3, INF)
    )


def start_on(grid):
    return StartBelief().bind(log_on(grid)).table(np.empty(0))


@pytest.fixture(params=[0.0, 0.7, -3.0])
def grid(request):
    return OccupancyGrid(CELLS, 0.5, (3.0, -1.0, request.param))


def test_draws_are_uniform_over_the_free_cells(grid):
    current = np.empty((3, 20000))
    contract.draw_start(start_on(grid), make_rng(np.random.SeedSequence(8)), current)
    column, row = grid.to_cells(current[:2].T).T
    count = np.zeros(CELLS.shape)
    np.add.at(count, (np.floor(row).astype(int), np.floor(column).astype(int)), 1)
    assert (count[CELLS != 0] == 0).all()
    assert stats.chisquare(count[CELLS == 0]).pvalue > 1e-4
    # Within a cell, too.
    assert stats.kstest(column % 1.0, "uniform").pvalue > 1e-4
    assert stats.kstest(row % 1.0, "uniform").pvalue > 1e-4


def test_the_density_is_one_over_the_free_area_there_and_zero_elsewhere(grid):
    rows, columns = np.indices((7, 6)) - 1
    centres = np.stack((columns, rows), axis=-1).reshape(-1, 2) + 0.5
    points = grid.from_cells(centres)
    current = np.vstack((points.T, np.full(len(points), 0.3)))
    logp = np.zeros(len(points))
    contract.start_logpdf(start_on(grid), current, logp)
    expected = np.full((7, 6), -INF)
    expected[1:6, 1:5][CELLS == 0] = -math.log(5 * 0.25) - math.log(2.0 * math.pi)
    np.testing.assert_allclose(logp, expected.ravel(), rtol=1e-12)


def test_a_grid_map_without_free_cells_has_no_start_anywhere():
    with pytest.raises(ModelError, match=r"log.nc: .* needs free cells, but the grid map hall.yaml has none"):
        start_on(OccupancyGrid(np.full((3, 3), 1), 0.5, (0.0, 0.0, 0.0), "hall.yaml"))


def test_places_of_effects_are_where_the_floor_is():
    # An L: a corridor along the lower edge, and one along the left edge.
    cells = np.full((80, 80), 2, dtype=np.uint8)
    cells[:20] = cells[:, :20] = 0
    cells[0] = 1
    log = log_on(OccupancyGrid(cells, 0.1))
    assert has_floor(log)
    assert not has_floor(log_on(OccupancyGrid(np.ones((3, 3), dtype=np.uint8), 0.1)))
    found = [place["place"] for place in floor_places(log)]
    # Of four by four cells, those along the lower and the left edge.
    assert len(found) == 7
    assert [x for x, y in found if y < 2.0] == [1.0, 3.0, 5.0, 7.0]
    assert [x for x, y in found if y > 2.0] == [1.0, 1.0, 1.0]
