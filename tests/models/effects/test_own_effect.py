"""An effect of one's own, as the documentation shows it, and what effects refuse."""

from __future__ import annotations

import textwrap
from dataclasses import replace

import numpy as np
import pytest
from oracles.effect_logs import BY_NAME, SONAR, base_tables, model_with, row_densities, sonar_log, true_values
from scipy import stats

import pmcl
import pmcl.models.effects
from pmcl.errors import ModelError
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.selection import effect_named
from pmcl.models.model_file import model_text, read_model
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensors.range_beams.sensor import RangeNoise


def documented():
    """Run the example of the package's documentation; return its names."""
    lines = pmcl.models.effects.__doc__.splitlines()
    begin = next(k for k, line in enumerate(lines) if line.startswith("    import numpy"))
    end = next(k for k in range(begin, len(lines)) if lines[k] and not lines[k].startswith("    "))
    scope = {}
    exec(textwrap.dedent("\n".join(lines[begin:end])), scope)
    return scope


@pytest.mark.slow
def test_the_documented_effect_can_be_simulated_and_calibrated():
    scope = documented()
    effect, model = scope["torque_steer"], scope["model"]
    log = pmcl.simulate_amigobot(200.0, 2, SONAR, effects=[(effect, [0.6])])
    assert log.true_theta["torque_steer"] == 0.6
    bound = model.bind(log)
    assert bound.names[-1] == "torque_steer"
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    theta = np.append(true_values(log)[:4], 0.0)
    values = []
    for pull in (0.0, 0.6, 1.2):
        theta[-1] = pull
        values.append(row_densities(bound.tables(theta)[0], path).sum())
    assert values[1] > max(values[0], values[2]) + 3.0
    draws = pmcl.calibrate(log, model, draws=100, chains=2, method=pmcl.ParticleGibbs(burn_in_particles=200), seed=1)
    from pmcl.posterior.access import parameter_draws

    assert abs(np.median(parameter_draws(draws, "torque_steer")) - 0.6) < 0.3


def test_a_model_file_cannot_hold_an_effect_of_ones_own():
    log = sonar_log()
    with pytest.raises(ModelError, match=r"effects that a model file can name.*torque-steer; keep this model"):
        model_text(documented()["model"], log)
    renamed = replace(documented()["torque_steer"], name="range-bias")
    with pytest.raises(ModelError, match="effects that a model file can name"):
        model_text(model_with(log, renamed), log)


def _effect(**changes):
    given = {
        "name": "made",
        "summary": "Made up.",
        "parameters": (Parameter("made", "m", stats.norm()),),
        "null": (0.0,),
        "change": lambda tables, values, log, where: tables,
    }
    return Effect(**{**given, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"carrier": "wheel"}, "carrier out of motion, range, landmark, sensor, map, but got 'wheel'"),
        ({"null": (0.0, 1.0)}, "one null value for each"),
        ({"parameters": ()}, "one null value for each"),
        ({"typical": {"huge": (1.0,)}}, "typical values for just visible, clear, large"),
        ({"typical": {"clear": (1.0, 2.0)}}, "1 each, but got 2 for 'clear'"),
        ({"parameters": (Parameter("made", "m", stats.uniform(1.0)),)}, "null of made within its prior, 1 to 2"),
        ({"shape": ("made",)}, "expected shape to name some"),
        ({"shape": ("other",)}, "expected shape to name some"),
    ],
)
def test_effects_that_contradict_themselves_are_refused(changes, message):
    with pytest.raises(ModelError, match=message) as caught:
        _effect(**changes)
    assert "\n" not in str(caught.value)


def test_edits_that_return_no_tables_are_told():
    log = sonar_log()
    wrong = _effect(change=lambda tables, values, log, where: tables.motion)
    with pytest.raises(ModelError, match="effect made: expected its change to return Tables, but got IncrementMotion"):
        wrong.edit(base_tables(log), [0.0], log)
    with pytest.raises(ModelError, match=r"expected a model with landmark sightings.*'RangeBeams'"):
        BY_NAME["bearing-bias"].edit(base_tables(log), [0.0], log)
    moved = base_tables(log)
    moved = moved._replace(motion=moved.start)
    with pytest.raises(ModelError, match="noisy increments or by odometry, but got a GaussianStart"):
        BY_NAME["odometry-arc"].edit(moved, [0.0], log)


def test_edited_arrays_are_laid_out_as_compiled_code_wants_them():
    log = sonar_log()

    def awkward(tables, values, log, where):
        mean = np.asfortranarray(tables.motion.mean + values[0])
        mean.flags.writeable = False
        return tables._replace(motion=tables.motion._replace(mean=mean))

    edited = _effect(change=awkward).edit(base_tables(log), [0.5], log)
    assert edited.motion.mean.flags.c_contiguous
    assert edited.motion.mean.flags.writeable
    np.testing.assert_allclose(edited.motion.mean, base_tables(log).motion.mean + 0.5)


def test_the_same_effect_twice_is_refused():
    log = sonar_log()
    one = BY_NAME["beam-bias"].instances(log)[1]
    with pytest.raises(ModelError, match=r"each effect once, but got beam-bias twice"):
        RobotModel(sensors=(RangeNoise(),), effects=(one, one))
    with pytest.raises(ModelError, match="occur twice"):
        model_with(log, _effect(parameters=(Parameter("sigma_left", "m", stats.norm()),)))


def test_places_and_names_that_do_not_exist_are_told():
    log = sonar_log()
    with pytest.raises(ModelError, match="did you mean 'range-scale'"):
        effect_named("range-scal")
    with pytest.raises(ModelError, match="beam-bias expected beams, but got walls"):
        effect_named("beam-bias", log, {"walls": [0]})
    with pytest.raises(ModelError, match="one of the 8 places that the log has, but got 11"):
        effect_named("beam-bias", log, {"beams": [11]})
    with pytest.raises(ModelError, match="range-bias expected no place, but got beams"):
        effect_named("range-bias", log, {"beams": [1]})
    with pytest.raises(ModelError, match="magnitude out of just visible, clear, large, but got 'huge'"):
        BY_NAME["range-bias"].magnitude("huge")


MISTAKES = {
    "effects = 3": "expected tables [[effects]]",
    "[[effects]]\nnam = 'range-bias'": "expected the name of an effect",
    "[[effects]]\nname = 'range-bais'": "did you mean 'range-bias'",
    "[[effects]]\nname = 'beam-bias'\nbeams = 2": "expected a list of numbers, but got 2",
    "[[effects]]\nname = 'beam-bias'\nbeams = ['a']": "expected a finite number, but got 'a'",
    "[[effects]]\nname = 'beam-bias'\nbeams = [9]": "one of the 8 places",
    "[[effects]]\nname = 'range-bias'\n[[effects]]\nname = 'range-bias'": "got range-bias twice",
    "[[effects]]\nname = 'range-bias'\n[fixed]\nrange_bia = 1.0": "did you mean 'range_bias'",
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.items())
def test_mistakes_in_model_files_are_told_in_one_line(text, message, tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(text)
    with pytest.raises(ModelError) as caught:
        read_model(path, sonar_log())
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_patches_and_obstacles_begin_where_they_are():
    log = sonar_log()
    places = BY_NAME["slippery-patch"].instances(log)
    assert len(places) > 5
    for one in places:
        assert log.walls.contains(one.where["place"])
        np.testing.assert_allclose(one.null[1:3], one.where["place"])
        assert one.parameters[1].prior.mean() == pytest.approx(one.where["place"][0])
    anywhere = BY_NAME["unmapped-obstacle"].at({"place": (0.33, 0.77)}, log)
    assert anywhere.null[1:3] == (0.33, 0.77)
