"""Statistics of the user's own: they become alarms, calibrated by the simulated logs, corrected for their number."""

from __future__ import annotations

import numpy as np
import pytest
from windowed_logs import unwrapped

from pmcl.cli.commands import pmcl as application
from pmcl.criticism import Statistic
from pmcl.criticism.fitting.quick_fit import BRIEF, quick_fit
from pmcl.criticism.judging.judged_log import judge_log
from pmcl.criticism.judging.locate import locate
from pmcl.criticism.scoring import statistics as module
from pmcl.criticism.scoring.covariates import RowCovariates
from pmcl.criticism.scoring.features import FAMILIES
from pmcl.criticism.scoring.statistics import (
    Residuals,
    checked_statistics,
    statistic_features,
    statistics_in_use,
    use_statistics,
)
from pmcl.criticism.settings import Settings
from pmcl.errors import CriticismError, ModelError
from pmcl.examples import example_text, own_statistic
from pmcl.models.robot_model import default_model

# mypy: disable-error-code="no-untyped-def"

NOISE = [0.03, 0.02, 0.04, 0.05]


def judged(tilt, statistics=(own_statistic.ARM_LEANS,)):
    """A log judged without candidates; no search follows."""
    log = own_statistic.record(tilt, duration=150.0)
    bound = default_model(log).bind(log.without_truth())
    fit = quick_fit(bound, 1, theta=np.array(NOISE), path=unwrapped(log.true_poses), effort=BRIEF)
    settings = Settings(500, 0, 0.05, 24, 2, 1, False, statistics=statistics)
    return judge_log(bound.logs[0], fit, (), settings)


@pytest.mark.slow
def test_what_only_its_user_knows_of_is_found_by_the_statistic_alone():
    with_statistic = judged(0.03)
    alarms = {alarm.family: alarm for alarm in with_statistic.judgement.alarms}
    own = alarms["arm-leans"]
    assert own.raised
    assert own.p_value < 1e-4
    assert own.z > 4.0
    assert [alarm.family for alarm in with_statistic.judgement.raised] == ["arm-leans"]
    place = locate(own, with_statistic.scored, {})
    assert place.channel == "arm-leans"
    assert place.moment == module.OWN
    assert 0 <= place.time[0] < place.time[1] <= 149


def test_an_arm_that_tilts_nothing_raises_no_alarm():
    judgement = judged(0.0).judgement
    own = judgement.alarms[-1]
    assert own.family == "arm-leans"
    assert own.p_value > 0.01
    assert not own.raised
    # Holm's correction counts the statistic: one family more than without it.
    built_in = [alarm for alarm in judgement.alarms if alarm.family in FAMILIES]
    assert len(judgement.alarms) == len(built_in) + 1
    assert judgement.p_value == min(1.0, len(judgement.alarms) * min(alarm.p_value for alarm in judgement.alarms))


def residuals(n=6, rows=4):
    covariates = ("distance", "direction", "incidence", "time", "speed", "turn_rate", "heading", "x", "y")
    return Residuals(
        kind=np.full(n, "range"), channel=np.arange(n) % 2, row=np.repeat([0, 1, 3], 2),
        residual=np.arange(n, dtype=float), log_score=np.zeros(n), **dict.fromkeys(covariates, np.zeros(n)),
        n_rows=rows,
    )  # fmt: skip


def test_numbers_of_readings_and_of_rows_are_summed_over_blocks():
    per_reading = Statistic("twice", "", lambda given: np.where(given.channel == 0, np.nan, 2.0 * given.residual))
    per_row = Statistic("count", "", lambda given: np.bincount(given.row, minlength=given.n_rows), per="row")
    features, blocks = statistic_features((per_reading, per_row), residuals())
    assert [feature.family for feature in features] == ["twice", "count"]
    # Two blocks of two rows each: the readings 1 and 3 lie in the first, the reading 5 in the second.
    np.testing.assert_array_equal(blocks, [[8.0, 10.0], [4.0, 2.0]])


@pytest.mark.parametrize(
    ("of", "message"),
    [
        (lambda given: given.residual[:3], r"odd: expected one number for each reading, shape \(6,\), but got"),
        (lambda given: 1.0, r"shape \(\)"),
        (lambda given: "much", "expected 6 numbers, but got could not convert"),
        (lambda given: np.full(6, np.inf), "expected finite numbers, or NaN for nothing, but got inf for reading 0"),
    ],
)
def test_what_is_no_number_for_each_reading_is_told_in_one_line(of, message):
    with pytest.raises(CriticismError, match=message):
        statistic_features((Statistic("odd", "", of),), residuals())


def test_names_are_checked():
    with pytest.raises(CriticismError, match="expected a name in lower case with hyphens, other than uniformity"):
        Statistic("score", "", len)
    with pytest.raises(CriticismError, match="in lower case"):
        Statistic("Arm Leans", "", len)
    with pytest.raises(CriticismError, match="expected per='reading' or per='row', but got 'log'"):
        Statistic("odd", "", len, per="log")
    with pytest.raises(CriticismError, match="two are called arm-leans"):
        checked_statistics([own_statistic.ARM_LEANS, own_statistic.ARM_LEANS])
    with pytest.raises(CriticismError, match="each of statistics"):
        checked_statistics([len])


def test_statistics_are_in_use_while_a_block_lasts():
    with use_statistics([own_statistic.ARM_LEANS]):
        assert statistics_in_use() == (own_statistic.ARM_LEANS,)
        with pytest.raises(CriticismError, match="two are called"), use_statistics([own_statistic.ARM_LEANS]):
            pass
        assert statistics_in_use() == (own_statistic.ARM_LEANS,)
    assert statistics_in_use() == ()


def test_a_file_gives_its_statistics_and_its_mistakes_are_told_with_the_line(tmp_path):
    from pmcl.models.effects.registry import run_file

    good, wrong = tmp_path / "own_statistic.py", tmp_path / "wrong.py"
    good.write_text(example_text("own_statistic"), encoding="utf-8")
    (statistic,) = module.statistics_in(run_file(good), good)
    assert statistic.name == "arm-leans"
    wrong.write_text("from pmcl.criticism import Statistic\nODD = Statistic('odd', '', lambda given: given.nothing)\n")
    (statistic,) = module.statistics_in(run_file(wrong), wrong)
    with pytest.raises(ModelError, match=r"wrong\.py, line 2: .*AttributeError"):
        statistic_features((statistic,), residuals())


def test_the_command_line_takes_a_file_with_a_statistic_only(tmp_path):
    from click.testing import CliRunner

    good, empty = tmp_path / "own_statistic.py", tmp_path / "empty.py"
    good.write_text(example_text("own_statistic"), encoding="utf-8")
    assert CliRunner().invoke(application, ["effects", "--effects", str(good)]).exit_code == 0
    empty.write_text("x = 1\n")
    refused = CliRunner().invoke(application, ["effects", "--effects", str(empty)])
    assert refused.exit_code != 0
    assert "pmcl.criticism.Statistic" in str(refused.exception) + refused.output


def test_a_residual_has_the_covariates_of_its_row():
    rows = RowCovariates(*(10.0 * k + np.arange(4.0) for k in range(6)))
    predictions = type("Some", (), {})()
    predictions.time, predictions.kind, predictions.kinds = np.array([1, 3]), np.array([0, 1]), ("range", "bearing")
    predictions.channel, predictions.log_score = np.array([5, 2]), np.array([-1.0, -2.0])
    of_readings = {name: np.array([7.0, 8.0]) for name in ("distance", "direction", "incidence")}
    made = module.residuals_of(predictions, np.array([0.5, np.nan]), of_readings, rows)
    assert made.kind.tolist() == ["range", "bearing"]
    assert made.residual[0] == 0.0
    assert np.isnan(made.residual[1])
    assert made.turn_rate.tolist() == [21.0, 23.0]
    assert made.y.tolist() == [51.0, 53.0]
    assert made.n_rows == 4
