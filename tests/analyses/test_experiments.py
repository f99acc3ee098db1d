"""The experiments of ``analyses/``, each in a small version: that they run, and that what they find is true."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ANALYSES = Path(__file__).parents[2] / "analyses"


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A function that runs an experiment in its small version, twice, and returns the folder of its results."""

    def run(experiment, *arguments):
        folder = tmp_path_factory.mktemp(experiment)
        command = [sys.executable, ANALYSES / experiment / "run.py", "--small", "--output", folder, *arguments]
        subprocess.run(command, check=True, timeout=500, capture_output=True)
        before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
        # What is there is not computed again.
        subprocess.run(command, check=True, timeout=60, capture_output=True)
        assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before
        assert before
        return folder

    return run


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.long
def test_longer_drives_tell_more_of_the_amigobot(small):
    folder = small("posterior_samples")
    short, long = (np.load(folder / f"amigobot_{seconds}_conditional.npz") for seconds in (40, 200))
    spreads = []
    for run in (short, long):
        flat = run["theta"].reshape(-1, 4).astype(float)
        off = (flat.mean(axis=0) - run["truth"]) / flat.std(axis=0)
        assert np.abs(off).max() < 4.0
        spreads.append(flat.std(axis=0))
    # Five times the data: the root of five where the prior no longer matters.
    assert 1.3 < np.exp(np.mean(np.log(spreads[0] / spreads[1]))) < 4.0


@pytest.mark.slow
def test_rows_come_in_as_r_says_and_rounds_of_m_move_theta(small):
    folder = small("effect_of_m_and_r")
    rows = {(int(row["m"]), int(row["r"])): row for row in read(folder / "settings.csv")}
    assert set(rows) == {(1, 3), (10, 3), (5, 3), (5, 30)}
    # A chain starts with r of 30 rows, and its first sweep adds r.
    assert int(rows[5, 3]["sweeps_until_complete"]) == 9
    assert int(rows[5, 30]["sweeps_until_complete"]) == 1
    # Ten rounds leave hardly a parameter where it was, one leaves about half of them.
    assert float(rows[1, 3]["moved"]) < 0.8 < 0.9 < float(rows[10, 3]["moved"])
    assert len({row["sweeps"] for row in read(folder / "curves.csv")}) > 10


@pytest.mark.long
def test_methods_agree_with_their_reference_as_far_as_their_errors_go(small):
    folder = small("convergence_comparison")
    methods = {row["method"]: row for row in read(folder / "methods.csv")}
    assert set(methods) == {"conditional:10", "smoothing:10", "ensemble:50", "reference"}
    exact = methods["conditional:10"]
    assert float(exact["error"]) < 6.0 * float(exact["expected_error"])
    curves = read(folder / "curves.csv")
    for name in ("conditional:10", "smoothing:10", "ensemble:50"):
        wall = np.array([float(row["wall"]) for row in curves if row["method"] == name])
        assert (np.diff(wall) > 0.0).all()


@pytest.mark.long
def test_the_position_error_hardly_depends_on_the_draws_per_reading(small):
    rows = {(row["draws"], row["k"]): row for row in read(small("draws_per_reading") / "results.csv")}
    assert set(rows) == {("mean", "0"), ("anew", "1"), ("anew", "5"), ("fixed", "1"), ("fixed", "5")}
    errors = [float(rows[way]["position_rmse"]) for way in (("mean", "0"), ("anew", "1"), ("anew", "5"))]
    assert max(errors) < 1.15 * min(errors)
    assert all(float(row["standard_error"]) > 0.0 for row in rows.values())


@pytest.mark.long
def test_a_filter_of_few_particles_does_better_with_inflated_noise(small):
    folder = small("the_paradox")
    found = {(row["kernel"], int(row["particles"])): row for row in read(folder / "calibrations.csv")}
    exact = found["conditional", 25]
    assert abs(float(exact["sigma_range_mean"]) - 0.02) < 4.0 * float(exact["sigma_range_sd"])
    inflated = [float(found["smoothing", n]["sigma_range_mean"]) / 0.02 for n in (25, 400)]
    assert inflated[0] > 2.0
    assert 1.0 < inflated[1] < 1.6
    errors = {}
    for row in read(folder / "errors.csv"):
        assert row["lost"] == "0"
        errors.setdefault((int(row["particles"]), row["source"]), []).append(float(row["error"]))
    # On the same ten trajectories each: smoothing beats the truth at 25 particles, nobody beats it much at 400.
    better = np.array(errors[25, "true"]) - np.array(errors[25, "smoothing"])
    assert better.mean() > 3.0 * better.std(ddof=1) / np.sqrt(len(better))
    many = {source: np.mean(errors[400, source]) for source in ("true", "smoothing", "conditional", "prior")}
    assert many["prior"] > 1.3 * many["true"]
    assert abs(many["conditional"] / many["true"] - 1.0) < 0.1
    evidence = {
        (int(row["particles"]), float(row["factor"])): float(row["log_evidence"])
        for row in read(folder / "landscape.csv")
        if row["trajectory"] == "0" and row["scanned"] == "range"
    }
    assert evidence[25, 4.0] > evidence[25, 1.0] + 100.0
    assert evidence[400, 1.0] > evidence[400, 4.0] + 100.0


def localization_errors(path):
    """Mean of each column for each method; no filter run may have lost the robot."""
    rows = read(path)
    assert all(row["lost"] == "0" for row in rows)
    means = {}
    for name in ("position", "heading", "score"):
        values = {}
        for row in rows:
            values.setdefault(row["method"], []).append(float(row[name]))
        means[name] = {method: np.mean(numbers) for method, numbers in values.items()}
    return means


@pytest.mark.long
def test_calibrated_parameters_localize_nearly_as_well_as_true_ones(small):
    mean = localization_errors(small("localization_error", "amigobot") / "errors_amigobot.csv")["position"]
    assert set(mean) == {"prior", "true", "mean", "map", "posterior"}
    assert mean["prior"] > 1.2 * mean["true"]
    for method in ("mean", "posterior"):
        assert abs(mean[method] / mean["true"] - 1.0) < 0.1


@pytest.mark.long
def test_a_calibrated_aibo_predicts_better_than_its_prior(small):
    errors = localization_errors(small("localization_error", "aibo") / "errors_aibo.csv")
    assert set(errors["score"]) == {"prior", "true", "mean", "map", "posterior"}
    for method in ("true", "mean", "posterior"):
        assert errors["score"][method] > errors["score"]["prior"]
        # A minute of walking leaves wide posteriors.
        assert errors["position"][method] < 1.2 * errors["position"]["true"]
    assert errors["heading"]["prior"] > 1.3 * errors["heading"]["true"]


@pytest.mark.long
def test_a_recorded_robot_has_measured_noise_instead_of_true_noise(small, shared_data):
    errors = localization_errors(small("localization_error", "mrclam") / "errors_mrclam.csv")
    assert set(errors["score"]) == {"prior", "measured", "mean", "map", "posterior"}
    assert max(errors["position"].values()) < 0.5
    # The noise found in a minute takes lasting errors for motion, and is surprised by later ones.
    assert errors["score"]["measured"] > errors["score"]["mean"]
    with_outliers = localization_errors(small("localization_error", "mrclam_outliers") / "errors_mrclam_outliers.csv")
    assert set(with_outliers["score"]) == {"prior", "mean", "map", "posterior"}


@pytest.mark.long
def test_a_hidden_effect_goes_through_the_whole_benchmark(tmp_path):
    """Made, criticised by something that is told nothing, scored; and what is scored is not made again."""

    def run(*arguments):
        results = ("--results", tmp_path / "results.csv")
        command = [sys.executable, ANALYSES / "hidden_effects" / "run.py", *arguments, *results]
        return subprocess.run(command, check=True, timeout=1500, capture_output=True, text=True).stdout

    logs = tmp_path / "logs"
    block = ("--effects", "range-scale", "--magnitudes", "large", "--places", "room", "--nulls", "0", "--pairs", "0")
    run("make", logs, *block)
    assert sorted(path.name for path in logs.iterdir()) == ["log-0000.nc", "sealed.json"]
    assert b"range-scale" not in (logs / "log-0000.nc").read_bytes()
    run("run", logs)
    assert "one large: 1 logs, found 1, named 1" in run("score", logs)
    (row,) = read(tmp_path / "results.csv")
    assert row["found"] == "range-scale"
    gap = float(row["score_of_truth"]) - float(row["score_before"])
    assert float(row["score_after"]) - float(row["score_before"]) > 0.8 * gap > 0.0
    assert abs(float(row["mean"]) - float(row["truth"])) < 5.0 * float(row["sd"])
    run("make", tmp_path / "again", *block)
    assert not list((tmp_path / "again").glob("log-*.nc"))


@pytest.mark.long
def test_exported_parameters_localize_better_than_defaults_on_the_other_part_of_a_drive(small, shared_data):
    folder = small("lidar_on_real_robots", "held_out")
    rows = read(folder / "held_out.csv")
    mean = {
        (which, settings, name): np.mean([
            float(row[name]) for row in rows if (row["map"], row["settings"]) == (which, settings)
        ])
        for which in ("as it is", "with margin") for settings in ("defaults", "hand", "export")
        for name in ("position_rmse", "readings", "truth")
    }  # fmt: skip
    for other in "defaults", "hand":
        assert mean["with margin", "export", "position_rmse"] < 0.8 * mean["with margin", other, "position_rmse"]
        assert mean["with margin", "export", "readings"] > mean["with margin", other, "readings"] + 20.0
        assert mean["with margin", "export", "truth"] > mean["with margin", other, "truth"]
    # Walls at the edge of the map's image cost more than parameters gain; rays of the beam model do not go there.
    assert mean["as it is", "export", "position_rmse"] > 1.5 * mean["with margin", "export", "position_rmse"]
    assert mean["as it is", "hand", "position_rmse"] == mean["with margin", "hand", "position_rmse"]
    assert "likelihood_field_prob" in (folder / "exported" / "jarvis_navigation_first_tempered.yaml").read_text()


@pytest.mark.long
def test_products_suit_independent_beams_and_are_too_sure_where_the_map_is_wrong(small):
    rows = read(small("lidar_on_real_robots", "combining") / "combining.csv")
    rows = [row for row in rows if row["start"] == "clicked"]
    mean = {}
    for name in "position_rmse", "coverage_95", "lost":
        for row in rows:
            key = row["log"].split(",")[1].strip(), row["numbers"], row["rule"], float(row["worth"]), name
            mean.setdefault(key, []).append(float(row[name]))
    mean = {key: np.mean(values) for key, values in mean.items()}
    assert all(value == 0.0 for key, value in mean.items() if key[4] == "lost")
    product, tempered, cubes = (
        ("calibrated", "product", 60.0), ("calibrated", "product", 2.0), ("defaults", "cubes", 60.0),
    )  # fmt: skip
    # So narrow a weight finds no particle among few.
    many = ("calibrated", "product, 20 000 particles", 60.0)
    right, wrong = ("right map",), ("wrong map",)
    assert mean[right + many + ("position_rmse",)] < 0.7 * mean[right + tempered + ("position_rmse",)]
    assert mean[wrong + product + ("coverage_95",)] < 0.3 < 0.6 < mean[wrong + tempered + ("coverage_95",)]
    # Nearly all of nav2's default belief is width.
    assert mean[wrong + cubes + ("coverage_95",)] > 0.99
    assert mean[right + cubes + ("position_rmse",)] > 2.0 * mean[right + many + ("position_rmse",)]


@pytest.mark.long
def test_a_robot_in_wean_hall_is_found_with_many_particles_and_better_foreseen_once_calibrated(small, shared_data):
    folder = small("wean_hall")
    found = {
        int(density): np.mean([
            int(row["found"]) for row in read(folder / "starts.csv")
            if row["recording"] == "1" and row["per_square_metre"] == density
        ])
        for density in ("2", "50")
    }  # fmt: skip
    assert found[50] == 1.0 > found[2]
    scores = read(folder / "scores.csv")
    mean = {
        choice: np.mean([float(row["log_score_per_row"]) for row in scores if row["choice"] == choice])
        for choice in ("nav2", "hand", "prior", "calibrated")
    }
    assert max(mean, key=mean.get) == "calibrated"


@pytest.mark.long
def test_methods_are_compared_and_cover_the_truth_as_they_say(small):
    folder = small("method_comparison")
    rows = {row["method"]: row for row in read(folder / "results.csv")}
    assert list(rows) == ["conditional", "least-squares", "prior"]
    assert all(not row["failure"] and float(row["position_error"]) > 0.0 for row in rows.values())
    # The prior mean is farther from the reference than what particle Gibbs finds in a second.
    assert float(rows["prior"]["error"]) > 2.0 * float(rows["conditional"]["error"])
    covered = read(folder / "coverage.csv")
    assert {row["seed"] for row in covered} == {"0", "1"}
    assert all(0.0 <= float(row["share_below"]) <= 1.0 for row in covered if row["method"] == "conditional")


@pytest.mark.long
def test_long_logs_and_pieces_of_a_drive_are_measured(small):
    folder = small("long_logs")
    rows = {(int(row["rows"]), int(row["pieces"])): row for row in read(folder / "results.csv")}
    assert set(rows) == {(60, 1), (120, 2)}
    for row in rows.values():
        mean, sd, truth = (np.array(row[name].split(), dtype=float) for name in ("means", "sds", "truth"))
        assert np.abs((mean - truth) / sd).max() < 5.0
        assert 0.1 < float(row["peak_memory_gb"]) < 4.0
    assert [float(row["ms_per_sweep"]) > 0.0 for row in read(folder / "sweeps.csv")] == [True]
