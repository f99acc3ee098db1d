"""Grid maps in figures: cells are where the map says, also when it is turned and thinned."""

import io

import matplotlib.image
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from synthetic_posterior import fake_case

from pmcl.maps import OccupancyGrid
from pmcl.maps.occupancy_grid import OCCUPIED, UNKNOWN
from pmcl.posterior.compat import find_group
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.files import read_posterior, write_posterior
from pmcl.posterior.log_groups import stored_grid
from pmcl.reports.map_drawing import draw_map
from pmcl.reports.path_figure import plot_trajectory


def room(rows, columns, resolution=0.05, origin=(-1.0, 2.0, 0.6)):
    """A room with a block in its corner, within unknown surroundings."""
    cells = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    inside = cells[rows // 8 : -rows // 8, columns // 8 : -columns // 8]
    inside[:] = 0
    inside[: inside.shape[0] // 4, : inside.shape[1] // 3] = OCCUPIED
    return OccupancyGrid(cells, resolution, origin)


def pixels(figure, axes, points):
    """Colours of a drawn figure at points of the axes' data, 0 to 1."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=figure.dpi)
    buffer.seek(0)
    picture = matplotlib.image.imread(buffer)
    across, up = axes.transData.transform(points).T
    return picture[picture.shape[0] - 1 - np.floor(up).astype(int), np.floor(across).astype(int), :3]


@pytest.mark.parametrize("size", [(64, 96), (1600, 2400)])
def test_each_cell_is_drawn_where_the_map_has_it(size):
    grid = room(*size)
    figure = Figure(figsize=(5, 5), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    entries = draw_map(axes, grid=grid)
    figure.canvas.draw()
    rows, columns = size
    # Places in the room and in its block, none at an edge.
    places = np.array([[0.5, 0.5], [0.8, 0.2], [0.2, 0.8], [0.2, 0.2], [0.3, 0.25]]) * [columns, rows]
    states = grid.state_at(grid.from_cells(places))
    assert states.tolist() == [0, 0, 0, 1, 1]
    colours = pixels(figure, axes, grid.from_cells(places))
    np.testing.assert_allclose(colours, np.where(states == OCCUPIED, 0.2, 1.0)[:, None] * np.ones(3), atol=0.01)
    # Unknown surroundings are cut away; what is left is on the axes as a whole.
    corners = np.array([[columns // 8, rows // 8], [columns - columns // 8, rows - rows // 8]])
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    for x, y in grid.from_cells(corners):
        assert left <= x <= right
        assert low <= y <= high
    assert max(right - left, high - low) < 1.3 * np.hypot(*grid.size)
    assert [entry.get_label() for entry in entries] == ["occupied"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")


def test_a_posterior_keeps_the_map_of_each_log_for_its_pages(tmp_path):
    case = fake_case(n_draws=20, n_logs=2, correlation=0.0)
    grid = room(1200, 2000, 0.01)
    object.__setattr__(case.logs[1], "grid_map", grid)
    data = to_arviz(case.chains, case.parameters, case.logs)
    write_posterior(data, tmp_path / "posterior.nc")
    constants = find_group(read_posterior(tmp_path / "posterior.nc"), "constant_data")
    assert stored_grid(constants, "_0") is None
    stored = stored_grid(constants, "_1")
    assert stored.fingerprint() == grid.coarser(800).fingerprint()
    assert stored.cells.shape == (400, 667)
    drawn = plot_trajectory(data, 1)
    assert {"occupied", "mean path", "walls"} <= {text.get_text() for text in drawn.legends[0].get_texts()}
    assert "occupied" not in {text.get_text() for text in plot_trajectory(data, 0).legends[0].get_texts()}
