"""A comparison from the log to its page: short runs of real methods, and made-up ones where the answer is known."""

from __future__ import annotations

import base64
import re
import time
from dataclasses import replace

import numpy as np
import pytest

from pmcl.comparison.compare import Comparison, Failure, MethodResult, compare
from pmcl.comparison.curves import learning_curve, reference_of
from pmcl.comparison.held_out import HeldOut, held_out_worth, peak_memory
from pmcl.comparison.methods import parse_methods
from pmcl.localization import localize
from pmcl.reports.comparison_report import (
    comparison_table,
    comparison_text,
    comparison_verdict,
    worth_table,
    write_comparison,
)
from pmcl.simulations.amigobot import simulate_amigobot

TRUTH = np.array([0.05, 0.3])


def made_up(method, theta, reference, seconds_per_draw=0.01):
    n_draws = theta.shape[1]
    time = 2.0 + seconds_per_draw * np.arange(1, n_draws + 1)
    flat = theta.reshape(-1, theta.shape[-1])
    curve = learning_curve(theta, time, 2.0 * time, reference, TRUTH)
    return MethodResult(method, len(theta), n_draws, 10.0, 2.0, 4.0, flat.mean(axis=0), flat.std(axis=0), curve)


@pytest.fixture
def comparison(rng):
    """Three methods: a good one, one of another density, and one that has not converged."""
    good = rng.normal([0.051, 0.31], [0.004, 0.02], (4, 1000, 2))
    reference = reference_of(rng.normal([0.051, 0.31], [0.004, 0.02], (4, 2000, 2)))
    inflated = rng.normal([0.055, 0.34], [0.004, 0.02], (4, 1000, 2))
    apart = good[:, :200] + 0.01 * np.arange(4)[:, None, None]
    results = [
        made_up(method, theta, reference)
        for method, theta in zip(parse_methods("conditional,smoothing:50,plain"), (good, inflated, apart), strict=True)
    ]
    return Comparison(
        log="a robot", names=("sigma_a", "sigma_b"), units=("m", "rad"), truth=TRUTH, reference=reference,
        reference_method=parse_methods("conditional:50")[0], reference_seconds=20.0,
        results=tuple(results), seconds=10.0,
        chains=4, seed=3,
    )  # fmt: skip


def test_the_verdict_tells_the_best_from_the_wrong_and_the_unfinished(comparison):
    verdict = comparison_verdict(comparison)
    assert verdict.converged
    assert verdict.message.startswith("conditional:25 drew most")
    assert "1 of 3 methods reached the posterior" in verdict.message
    assert any(line.startswith("smoothing:50 has converged, but") for line in verdict.advice)
    assert any(line.startswith("plain:25 has not converged") for line in verdict.advice)
    rows = comparison_table(comparison).rows
    assert [row.short for row in rows] == [False, True, True]
    # Chains that have not met have no effective sample size.
    assert [row.cells[6] == "-" for row in rows] == [False, False, True]


def test_the_numbers_are_those_of_the_draws(comparison):
    good, inflated, _ = comparison.results
    # 4000 draws in 10 s of clock, twice that of CPU.
    assert good.ess_per_cpu_second == pytest.approx(4000.0 / 20.0, rel=0.15)
    assert inflated.curve.error[-1] == pytest.approx(np.sqrt((1.0 + 1.5**2) / 2.0), abs=0.1)
    text = comparison_text(comparison)
    assert max(map(len, text.splitlines())) <= 100
    lines = text.split("\n\n")[0].splitlines()
    assert [line.split()[1:4] for line in lines[1:]] == [["4", "x", "1000"], ["4", "x", "1000"], ["4", "x", "200"]]
    assert len({len(line.removesuffix(" *")) for line in lines}) == 1
    assert lines[0].split()[0] == "method"
    assert [line.endswith(" *") for line in lines[1:]] == [False, True, True]


def test_a_reference_that_has_not_converged_spoils_the_verdict(comparison):
    poor = replace(comparison, reference=comparison.reference._replace(r_hat=1.2))
    verdict = comparison_verdict(poor)
    assert not verdict.converged
    assert "The reference has not converged (R-hat 1.200" in verdict.message
    assert "--seconds" in verdict.advice[0]


def test_a_method_without_draws_is_told_of(comparison, tmp_path):
    poor = replace(comparison, failures=(Failure(parse_methods("ensemble:200")[0], "the time was over"),))
    assert "ensemble:200 made no draw: the time was over." in comparison_verdict(poor).advice
    assert "1 of 4 methods" in comparison_verdict(poor).message
    assert comparison_table(poor).rows[-1].cells[:3] == ("ensemble:200", "none", "-")
    write_comparison(poor, tmp_path / "page.html")
    assert "ensemble:200 made no draw" in (tmp_path / "page.html").read_text()


def test_a_method_that_is_late_is_told_of(comparison):
    late = replace(comparison, results=(replace(comparison.results[0], seconds=12.0), *comparison.results[1:]))
    assert "instead of 10 s" not in " ".join(comparison_verdict(comparison).advice)
    assert "conditional:25 took 12.0 s instead of 10 s" in " ".join(comparison_verdict(late).advice)


def test_without_truth_there_is_no_column_of_it(comparison, tmp_path):
    curves = [result.curve._replace(error_of_truth=np.full_like(result.curve.error, np.nan))
              for result in comparison.results]  # fmt: skip
    results = tuple(replace(result, curve=curve) for result, curve in zip(comparison.results, curves, strict=True))
    blind = replace(comparison, truth=None, results=results)
    assert not any("truth" in column for column in comparison_table(blind).columns)
    write_comparison(blind, tmp_path / "page.html")


@pytest.mark.slow
def test_real_methods_end_on_one_page(tmp_path):
    log = simulate_amigobot(20.0, seed=2)
    made = compare(log, "conditional:8,plain:8,ensemble:20", seconds=2.0, chains=2, seed=1, held_out=0.25)
    assert made.failures == ()
    assert [str(result.method) for result in made.results] == ["conditional:8", "plain:8", "ensemble:20"]
    assert made.names == ("sigma_forward", "sigma_left", "sigma_turn", "sigma_range")
    np.testing.assert_allclose(made.truth, [log.true_theta[name] for name in made.names])
    for result in made.results:
        assert result.draws >= 1
        assert 0.0 < result.burn_in < result.curve.wall[-1] <= result.seconds
        assert np.all(np.diff(result.curve.wall) > 0.0)
        assert np.isfinite(result.curve.error).all()
        assert np.isfinite(result.held_out.log_score)
        assert 0.0 < result.held_out.position_error < 5.0
    assert made.held_out_rows == round(0.25 * log.n_steps)
    path = tmp_path / "page.html"
    write_comparison(made, path)
    text = path.read_text(encoding="utf-8")
    for result in made.results:
        assert str(result.method) in text
        assert result.method.description.replace("'", "&#39;") in text
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert len(pictures) == 2
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)
    assert not re.search(r"https?://|@import|url\(|<script|<link", text)


def test_what_a_mean_is_worth_tells_the_truth_from_a_wrong_theta():
    """The negative control: readings are far less noisy than a filter with three times their noise believes."""
    log = simulate_amigobot(60.0, seed=2)
    split = log.n_steps // 2
    right = held_out_worth(log, None, log.true_theta, split, 1)
    wrong = held_out_worth(log, None, {**log.true_theta, "sigma_range": 5.0 * log.true_theta["sigma_range"]}, split, 1)
    assert right.log_score > wrong.log_score + 8.0 * np.hypot(right.log_score_error, wrong.log_score_error)
    track = localize(log, theta=log.true_theta, particles=500, seed=1)
    assert abs(track.log_score[split:].mean() - right.log_score) < 8.0 * right.log_score_error


def test_a_worse_log_score_is_marked(comparison):
    scores = [HeldOut(-1.0, 0.01, 0.1), HeldOut(-1.5, 0.01, 0.2), HeldOut(np.nan, np.nan, np.nan)]
    results = tuple(
        replace(result, held_out=worth) for result, worth in zip(comparison.results, scores, strict=True)
    )
    held = replace(comparison, results=results, held_out_rows=20, reference_held_out=HeldOut(-1.01, 0.01, 0.1))
    table = worth_table(held)
    assert [row.short for row in table.rows] == [False, True, True, False]
    assert table.rows[2].cells[2:] == ("-", "-", "-")
    assert "last 20 rows" in comparison_text(held)
    assert worth_table(comparison).columns == ("method", "MB")


def test_the_growth_of_memory_is_seen():
    with peak_memory() as peak:
        block = np.ones(5_000_000)
        time.sleep(0.2)
        del block
    if np.isnan(peak.value):
        pytest.skip("this system does not tell the memory of a process")
    assert 30.0 < peak.value < 80.0
