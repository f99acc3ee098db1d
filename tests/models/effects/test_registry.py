"""Effects from outside: files and installed packages, and what is said of those that cannot be used."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from oracles.effect_logs import field_log, sonar_log

from pmcl import registry
from pmcl.errors import ModelError
from pmcl.examples import example_text
from pmcl.examples.own_effect import TORQUE_STEER
from pmcl.models.effects import CATALOGUE, candidates, effect_named, known_effects, read_effects, use_effects
from pmcl.models.effects.registry import check_on
from pmcl.models.model_file import model_of_text, model_text
from pmcl.models.robot_model import RobotModel, default_model


@pytest.fixture
def own(tmp_path):
    """A function that writes a file of effects and returns its path; with changes to the example."""

    def write(*changes, text=None):
        text = example_text("own_effect") if text is None else text
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "mine.py"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_effects_of_a_file_are_known_as_long_as_they_are_in_use(own):
    log, before = sonar_log(), known_effects()
    assert before == CATALOGUE
    (effect,) = read_effects(own())
    assert effect.name == "torque-steer"
    with use_effects([effect]):
        assert known_effects() == (*CATALOGUE, effect)
        assert candidates(log)[-1] is effect
        assert effect_named("torque-steer") is effect
        model = RobotModel(sensors=default_model(log).sensors, effects=(effect,))
        text = model_text(model, log)
        assert model_of_text(text, log).effects == (effect,)
    assert known_effects() == before
    with pytest.raises(ModelError, match=r"'torque-steer'; 'pmcl effects' lists them; --effects FILE\.py"):
        effect_named("torque-steer")
    with pytest.raises(ModelError, match="torque-steer"):
        model_of_text(text, log)


def test_an_effect_of_a_file_does_what_its_function_does(own):
    log = sonar_log()
    (effect,) = read_effects(own())
    tables = default_model(log).bind(log).tables(np.array([0.05, 0.03, 0.02, 0.1]))[0]
    mean = effect.edit(tables, [0.5], log).motion.mean
    np.testing.assert_array_equal(mean, TORQUE_STEER.edit(tables, [0.5], log).motion.mean)
    np.testing.assert_allclose(mean[1:, 2] - tables.motion.mean[1:, 2], 0.5 * np.diff(tables.motion.mean[:, 0]))


# Changes to the example, and what is said of them. Lines are those of the file.
BROKEN = {
    "syntax": ([("(pull,) = values", "(pull,) = = values")], r"mine\.py, line 23: .*SyntaxError"),
    "import": ([("import numpy as np", "import numpyy as np")], r"mine\.py, line 14: .*No module named 'numpyy'"),
    "carrier": ([('carrier="motion"', 'carrier="wheel"')], r"mine\.py, line 29: effect torque-steer: .*carrier out of"),
    "name taken": ([('name="torque-steer"', 'name="range-bias"')], r"mine\.py: .*an effect range-bias already"),
    "no size": ([('"clear": (0.5,), ', "")], r"torque-steer: expected typical values for 'clear'"),
    "no effect": ([("TORQUE_STEER = Effect(", "TORQUE_STEER = dict(")], r"at least one pmcl\.models\.effects\.Effect"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_files_that_cannot_be_used_are_told_with_their_line(case, own):
    changes, message = BROKEN[case]
    with pytest.raises(ModelError, match=message) as caught:
        read_effects(own(*changes))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(ModelError, match="expected a Python file with effects, but got 'No such file or directory'"):
        read_effects(tmp_path / "none.py")


# What a function does wrong, and what is said when it is first tried on a log.
WRONG = {
    "crashes": ("mean[1:, 2] += pull", "mean[1:, 2] += pulll", r"mine\.py, line \d+: .*NameError: name 'pulll'"),
    "shape": ("tables.motion._replace(mean=mean)", "tables.motion._replace(mean=mean[1:])", r"'motion.mean' of shape"),
    "in place": (".mean.copy()", ".mean", "altered 'motion.mean'; change a copy"),
    "not finite": ("+= pull *", "+= (np.inf if pull else 0.0) *", "finite numbers in 'motion.mean', but got"),
    "null": ("+= pull *", "+= 0.1 + pull *", r"no change at its null \[0.0\], but 'motion.mean' differs"),
}


@pytest.mark.parametrize("case", WRONG)
def test_functions_that_do_wrong_are_told_before_anything_runs(case, own):
    old, new, message = WRONG[case]
    (effect,) = read_effects(own((old, new)))
    with use_effects([effect]), pytest.raises(ModelError, match=message) as caught:
        candidates(sonar_log())
    assert "\n" not in str(caught.value)


def test_effects_of_the_catalogue_pass_the_same_check():
    for log in (sonar_log(), field_log()):
        for effect in candidates(log)[:10]:
            check_on(effect, log)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A function that puts a package with an entry point on the path, as an installer does."""

    def install(target):
        (tmp_path / "wheelworks.py").write_text(example_text("own_effect"), encoding="utf-8")
        metadata = tmp_path / "wheelworks-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: wheelworks\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text(f"[pmcl.effects]\nsteer = {target}\n")
        monkeypatch.syspath_prepend(str(tmp_path))
        importlib.invalidate_caches()
        registry._of_packages.cache_clear()

    yield install
    monkeypatch.undo()
    registry._of_packages.cache_clear()


def test_installed_packages_offer_effects(installed):
    installed("wheelworks:TORQUE_STEER")
    assert effect_named("torque-steer").summary == TORQUE_STEER.summary
    assert candidates(sonar_log())[-1].name == "torque-steer"


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("wheelworks:NOTHING", "'steer' of wheelworks: .*loading wheelworks:NOTHING failed"),
        ("wheelworks:pulled", "'steer' of wheelworks: expected an effect .* but got a function"),
    ],
)
def test_packages_that_offer_something_else_are_named(installed, target, message):
    installed(target)
    with pytest.raises(ModelError, match=message):
        known_effects()
