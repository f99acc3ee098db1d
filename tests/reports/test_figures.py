from __future__ import annotations

import io
import sys
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from synthetic_posterior import NAMES, TRUTH, autoregressive, fake_case, fake_parameters, true_path

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import assemble
from pmcl.posterior.convert import to_arviz
from pmcl.reports import figures
from pmcl.reports.chain_figures import autocorrelation
from pmcl.reports.style import evenly_spaced, labelled

PLOTS = [getattr(figures, name) for name in figures.__all__]
THETA_PLOTS = [plot for plot in PLOTS if plot is not figures.plot_trajectory]


def rendered(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=50)
    return buffer.getvalue()


def visible_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("plot", PLOTS)
def test_every_figure_renders_and_stays_out_of_pyplot(plot, report_data):
    assert rendered(plot(report_data)).startswith(b"\x89PNG")
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


@pytest.mark.parametrize("plot", PLOTS)
def test_nothing_sticks_out_of_the_picture(plot, report_data):
    figure = plot(report_data)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
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
    curve = figures.plot_pair(report_data).axes[8].get_lines()[0]
    grid = np.asarray(curve.get_xdata())
    np.testing.assert_allclose(curve.get_ydata(), report_case.parameters[2].prior.pdf(grid))


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
    assert {"walls", "mean path", "true path", "sampled paths"} <= set(visible_texts(figure))


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
