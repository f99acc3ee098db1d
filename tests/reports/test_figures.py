from __future__ import annotations

import io
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from synthetic_posterior import NAMES, TRUTH, autoregressive, fake_case, fake_parameters, true_path

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import assemble, find_group, group_names
from pmcl.posterior.convert import to_arviz
from pmcl.reports import figures, path_figure
from pmcl.reports.bands import band_over_time, mass_levels
from pmcl.reports.chain_figures import _panels, autocorrelation
from pmcl.reports.residual_figures import plot_residuals, residual_channels
from pmcl.reports.style import evenly_spaced, labelled, legend_above, tidy

PLOTS = [getattr(figures, name) for name in figures.__all__]
THETA_PLOTS = [plot for plot in PLOTS if plot is not figures.plot_trajectory]


def rendered(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=50)
    return buffer.getvalue()


def visible_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.fixture(scope="module", params=PLOTS)
def drawn(request, report_data):
    """Each figure, drawn once."""
    figure = request.param(report_data)
    FigureCanvasAgg(figure).draw()
    return figure


def test_every_figure_renders_and_stays_out_of_pyplot(drawn):
    assert rendered(drawn).startswith(b"\x89PNG")
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or pyplot.get_fignums() == []


@pytest.mark.parametrize(
    ("plot", "across", "up"),
    [
        (figures.plot_rank, "rank among all draws", "chain"),
        (figures.plot_autocorrelation, "lag [draws]", "autocorrelation"),
        (figures.plot_ess_evolution, "draws per chain", "effective draws, all chains"),
    ],
)
def test_panels_that_stand_alone_are_labelled_each(plot, across, up, report_data):
    labels = {(axes.get_xlabel(), axes.get_ylabel()) for axes in plot(report_data).axes}
    assert labels == {(across, up)}


def test_traces_are_labelled_with_units(report_data):
    left = plot_columns(figures.plot_trace(report_data))[0]
    assert [axes.get_ylabel() for axes in left] == [
        "sigma_forward\n[m]",
        "sigma_turn\n[rad]",
        "sigma_range\n[m]",
        "log joint\n[nat]",
    ]
    assert left[-1].get_xlabel() == "draw"


def plot_columns(figure):
    return figure.axes[0::2], figure.axes[1::2]


def test_nothing_sticks_out_of_the_picture(drawn):
    figure, renderer = drawn, drawn.canvas.get_renderer()
    for axes in figure.axes:
        if axes.axison:
            box = axes.get_tightbbox(renderer)
            assert box.x0 >= -1.0
            assert box.y0 >= -1.0
            assert box.x1 <= figure.bbox.x1 + 1.0
            assert box.y1 <= figure.bbox.y1 + 1.0


def test_units_are_on_the_pair_plot(report_data):
    figure = figures.plot_pair(report_data)
    labels = [axes.get_xlabel() for axes in figure.axes if axes.get_xlabel()]
    assert labels == ["sigma_forward\n[m]", "sigma_turn\n[rad]", "sigma_range\n[m]"]
    assert figure.axes[0].get_ylabel() == "density [1/m]"


def test_true_values_are_marked_where_they_are(report_data):
    figure = figures.plot_pair(report_data)
    rendered(figure)
    below = figure.axes[3 * 2 + 0]
    marks = [line for line in below.get_lines() if line.get_linestyle() not in ("None", "-")]
    assert marks[0].get_xdata()[0] == TRUTH["sigma_forward"]
    assert marks[1].get_ydata()[0] == TRUTH["sigma_range"]
    assert below.get_xlim()[0] < TRUTH["sigma_forward"] < below.get_xlim()[1]
    assert "true value" in visible_texts(figure)


def test_a_truth_far_outside_does_not_shrink_the_posterior(report_case):
    logs = [replace(report_case.logs[0], true_theta={**TRUTH, "sigma_range": 40.0})]
    figure = figures.plot_pair(to_arviz(report_case.chains, report_case.parameters, logs))
    assert figure.axes[-1].get_xlim()[1] < 1.0


def test_the_prior_on_the_diagonal_is_its_density(report_case, report_data):
    axes = figures.plot_pair(report_data).axes[8]
    curve = axes.get_lines()[0]
    expected = report_case.parameters[2].prior.pdf(np.asarray(curve.get_xdata()))
    scale = curve.get_ydata() / expected
    # On a scale of its own, so that it is seen beside a posterior that is much narrower.
    np.testing.assert_allclose(scale, scale[0])
    assert 0.5 < curve.get_ydata().max() / axes.get_ylim()[1] < 0.7


def test_without_truth_none_is_drawn_or_named():
    case = fake_case(n_draws=50, truth=False, landmarks=True)
    data = to_arviz(case.chains, case.parameters, case.logs)
    for plot in (figures.plot_pair, figures.plot_trace, figures.plot_trajectory):
        texts = visible_texts(plot(data))
        assert texts
        assert not any("true" in text or "error" in text for text in texts)


def test_the_path_is_on_its_map(report_case, report_data):
    figure = figures.plot_trajectory(report_data)
    room = figure.axes[0]
    collections = [one for one in room.collections if isinstance(one, LineCollection)]
    assert len(collections[0].get_segments()) == report_case.logs[0].dataset.sizes["wall_index"]
    lines = {line.get_label(): np.asarray(line.get_xydata()) for line in room.get_lines()}
    np.testing.assert_allclose(lines["true path"], true_path(60)[:, :2])
    assert np.abs(lines["mean path"] - true_path(60)[:, :2]).max() < 0.05
    assert room.get_xlim()[0] <= 0.0 < 6.0 <= room.get_xlim()[1]
    assert (room.get_xlabel(), room.get_ylabel()) == ("x [m]", "y [m]")
    expected = {"walls", "mean path", "true path", "start", "end", "90 % ellipses of the position"}
    assert expected <= set(visible_texts(figure))
    assert lines["start"].tolist() == [lines["mean path"][0].tolist()]
    assert lines["end"].tolist() == [lines["mean path"][-1].tolist()]


def test_the_ellipses_hold_nine_of_ten_positions(rng):
    covariance = np.array([[0.09, 0.03], [0.03, 0.04]])
    positions = rng.multivariate_normal([1.0, 2.0], covariance, size=(4000, 1))
    ellipse = path_figure._ellipses(Figure().subplots(), positions, np.array([[1.0, 2.0]]))
    width, height, angle = (float(values[0]) for values in (ellipse._widths, ellipse._heights, ellipse._angles))
    c, s = np.cos(angle), np.sin(angle)
    along = (positions[:, 0] - [1.0, 2.0]) @ np.array([[c, -s], [s, c]])
    inside = (along[:, 0] / width) ** 2 + (along[:, 1] / height) ** 2 <= 1.0
    # Half axes are kept; the standard error of the share is 0.005.
    assert inside.mean() == pytest.approx(0.9, abs=0.02)


def test_heading_errors_are_wrapped(report_data):
    figure = figures.plot_trajectory(report_data)
    heading = next(axes for axes in figure.axes if axes.get_ylabel() == "heading [rad]")
    assert max(np.max(line.get_ydata()) for line in heading.get_lines()) < 0.1


def test_landmarks_of_the_chosen_log_are_drawn():
    case = fake_case(n_draws=50, n_logs=2, landmarks=True)
    data = to_arviz(case.chains, case.parameters, case.logs)
    figure = figures.plot_trajectory(data, 1)
    spots = next(line for line in figure.axes[0].get_lines() if line.get_label() == "landmarks")
    np.testing.assert_array_equal(spots.get_xydata(), case.logs[1].dataset["landmark_position"])
    with pytest.raises(PosteriorError, match="got 2"):
        figures.plot_trajectory(data, 2)


def _with(case, theta, names, units):
    chains = replace(
        case.chains, names=names, units=units, theta=theta, statistics={}, warmup_theta=np.empty((len(theta), 0, 1))
    )
    return to_arviz(chains, fake_parameters(names, units), case.logs)


@pytest.mark.slow
@pytest.mark.parametrize("plot", THETA_PLOTS)
@pytest.mark.parametrize("kind", ["one parameter", "seven long names", "never moved", "two draws"])
def test_unusual_posteriors_can_be_drawn(plot, kind):
    n_draws = 2 if kind == "two draws" else 60
    case = fake_case(n_draws=n_draws, n_stored=1)
    names, units, theta = NAMES, ("m", "rad", ""), case.chains.theta
    if kind == "one parameter":
        names, units, theta = names[:1], units[:1], theta[..., :1]
    elif kind == "seven long names":
        names = tuple(f"sigma_turn_per_metre_{index}" for index in range(7))
        units = ("rad",) * 7
        theta = np.abs(autoregressive(np.random.default_rng(0), 4, n_draws, 7, 0.0))
    elif kind == "never moved":
        theta = np.full_like(theta, 0.02)
    assert rendered(plot(_with(case, theta, names, units))).startswith(b"\x89PNG")


@pytest.mark.parametrize("plot", THETA_PLOTS)
def test_a_posterior_of_another_program_can_be_drawn(plot):
    draws = np.random.default_rng(0).normal(size=(2, 100))
    other = assemble({"posterior": xr.Dataset({"mu": (("chain", "draw"), draws)})}, {})
    assert rendered(plot(other)).startswith(b"\x89PNG")


def test_rank_bars_of_a_chain_apart_are_where_they_belong():
    case = fake_case(n_draws=400, correlation=0.0)
    theta = case.chains.theta.copy()
    theta[3] += 1.0
    axes = figures.plot_rank(_with(case, theta, NAMES, ("m", "rad", "m"))).axes[0]
    top = [bar for bar in axes.patches if bar.get_y() == 3.0]
    assert [bar.get_height() > 0.0 for bar in top] == [False] * 15 + [True] * 5
    assert max(bar.get_y() + bar.get_height() for bar in axes.patches) < 4.0
    flat = top[-1].get_height() / 4.0
    counts = sum(bar.get_height() / flat * 20 for bar in axes.patches)
    assert counts == pytest.approx(1600.0)


def test_autocorrelation_is_that_of_the_process_and_of_numpy():
    chains = autoregressive(np.random.default_rng(0), 2, 20000, 1, 0.7)
    lags = autocorrelation(chains)[..., 0].mean(axis=0)
    # Bartlett's standard error at these lags is about 0.008 for two chains of this length.
    np.testing.assert_allclose(lags[:6], 0.7 ** np.arange(6), atol=0.03)
    short = chains[:1, :50]
    centred = short[0, :, 0] - short[0, :, 0].mean()
    expected = [centred[: 50 - lag] @ centred[lag:] / (centred @ centred) for lag in range(25)]
    np.testing.assert_allclose(autocorrelation(short)[0, :, 0], expected, atol=1e-12)


def test_labels_break_at_underscores():
    assert labelled("sigma_range", "m") == "sigma_range [m]"
    assert labelled("ratio", "") == "ratio"
    assert labelled("sigma_turn_per_metre", "rad/m", narrow=True) == "sigma_turn_\nper_metre\n[rad/m]"
    assert labelled("averyveryverylongname", "", narrow=True) == "averyveryverylongname"


def test_thinning_keeps_both_ends():
    np.testing.assert_array_equal(evenly_spaced(3, 10), [0, 1, 2])
    assert evenly_spaced(1000, 7).tolist()[0::6] == [0, 999]
    assert len(evenly_spaced(1000, 7)) == 7


def test_every_colour_is_in_a_legend(drawn):
    figure = drawn
    assert len(visible_texts(figure)) >= 2
    named = {to_hex(handle.get_color()) for legend in figure.legends for handle in legend.get_lines()}
    named |= {to_hex(patch.get_facecolor()) for legend in figure.legends for patch in legend.get_patches()}
    drawn = {
        to_hex(line.get_color())
        for axes in figure.axes
        for line in axes.get_lines()
        if line.get_linewidth() > 1.0 and line.get_linestyle() != "None" and np.size(line.get_xdata()) > 2
    }
    assert drawn <= named


def test_ticks_are_plain_numbers(drawn):
    for axes in drawn.axes:
        assert axes.has_data() or not axes.axison
        for axis in (axes.xaxis, axes.yaxis):
            labels = [label.get_text() for label in axis.get_ticklabels(which="both")]
            assert not any("10^" in label or "e-" in label for label in labels)
            assert axis.get_offset_text().get_text() == ""


@pytest.mark.parametrize(
    ("low", "high", "expected"), [(0.15, 0.9, ["0.2", "0.5"]), (0.002, 500.0, ["0.01", "0.1", "1", "10", "100"])]
)
def test_logarithmic_ticks_are_written_in_full(low, high, expected):
    figure = Figure()
    axes = figure.subplots()
    axes.plot([1, 2], [low, high])
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    tidy(axes)
    FigureCanvasAgg(figure).draw()
    shown = [label.get_text() for tick, label in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)
             if low <= tick <= high]  # fmt: skip
    assert shown == expected
    assert not any(label.get_text() for label in axes.get_yticklabels(minor=True))


def test_priors_are_shown_over_their_whole_range(report_case, report_data):
    figure = figures.plot_marginals(report_data)
    assert len(figure.axes) == 6
    left, right = figure.axes[0], figure.axes[1]
    prior = report_case.parameters[0].prior
    assert left.get_xlim()[1] == pytest.approx(prior.ppf(0.99), rel=0.1)
    assert right.get_xlim()[1] < 0.3 * left.get_xlim()[1]
    assert (left.get_xlabel(), right.get_xlabel()) == ("sigma_forward [m]",) * 2
    other = assemble({"posterior": xr.Dataset({"mu": (("chain", "draw"), np.arange(20.0).reshape(2, 10))})}, {})
    assert len(figures.plot_marginals(other).axes) == 1


@pytest.mark.parametrize("count", range(1, 26))
def test_no_panel_is_alone_in_the_last_row(count):
    panels = _panels(count, 1.0)[1]
    assert len(panels) == count
    last = [axes for axes in panels if axes.get_subplotspec().rowspan == panels[-1].get_subplotspec().rowspan]
    assert len(last) > 1 or count == 1


def test_legends_are_no_wider_than_the_figure():
    labels = ["chain 0", "chain 1", "chain 2", "chain 3", "all bars are this high when the chains agree"]
    for width in (4.0, 6.4, 10.0):
        figure = Figure(figsize=(width, 3.0), layout="constrained")
        figure.subplots()
        legend_above(figure, [Line2D([], [], label=label) for label in labels])
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        box = figure.legends[0].get_window_extent(canvas.get_renderer())
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1


def test_bands_are_quantiles_in_time():
    times = np.arange(1000.0)
    values = np.stack([times, times + 2000.0], axis=1)
    values[:500] = np.nan
    band = band_over_time(times, values, 10)
    assert len(band.time) == 5
    assert band.time[0] == pytest.approx(549.45)
    assert band.median[-1] == pytest.approx(1950.0, abs=60.0)
    assert band.low[-1] == pytest.approx(910.0, abs=2.0)
    assert band.high[-1] == pytest.approx(2990.0, abs=2.0)


def test_regions_hold_their_share_of_a_normal_distribution():
    grid = np.linspace(-6.0, 6.0, 301)
    density = np.exp(-0.5 * (grid[:, None] ** 2 + grid**2))
    outer, inner = mass_levels(density, (0.9, 0.5))
    # Of a normal distribution in two dimensions, the share p lies where the density is above 1 - p of its top.
    assert outer == pytest.approx(0.1, rel=0.02)
    assert inner == pytest.approx(0.5, rel=0.02)


def test_residuals_are_shown_for_what_was_checked(report_case, report_data, rng):
    assert residual_channels(report_data, 0, 1) == {}
    scores = rng.normal(size=(60, 4))
    scores[::7] = np.nan
    data = checked(report_data, scores)
    assert residual_channels(data, 0, 1) == {"residual_range": "ranges"}
    figure = plot_residuals(data, 0, 1)
    assert len(figure.axes) == 2
    title = figure.axes[0].get_title()
    assert abs(float(title.rsplit(" ", 1)[1])) < 0.3
    assert len(visible_texts(figure)) == 4
    lasting = np.cumsum(scores[1:6], axis=0).repeat(12, axis=0)
    assert float(plot_residuals(checked(report_data, lasting), 0, 1).axes[0].get_title().rsplit(" ", 1)[1]) > 0.8


def checked(data, scores):
    """The posterior with a group of normal scores, as the check of a calibration writes it."""
    groups = {name: find_group(data, name) for name in group_names(data)}
    times = groups["constant_data"]["time"]
    groups["predictive_check"] = xr.Dataset({"residual_range": (("time", "beam"), scores)}, coords={"time": times})
    return assemble(groups, {})
