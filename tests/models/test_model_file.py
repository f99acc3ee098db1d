"""Model files: what is written is read back as the same model, and every mistake is told in one line with its key."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from scipy import stats

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_file import model_text, read_model
from pmcl.models.motions.increments.motion import GrowingIncrementNoise, IncrementNoise
from pmcl.models.motions.odometry.motion import Differential, Omni
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.sensors.lidar.sensor import Lidar
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.models.starts.belief import StartBelief
from pmcl.sampling.checkpoint import fingerprint
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field
from pmcl.simulations.lidar_room import simulate_lidar_room

INF = float("inf")
RANGES = (RangeNoise(),)


@pytest.fixture(scope="module")
def sonar_log():
    return simulate_amigobot(20.0)


@pytest.fixture(scope="module")
def landmark_log():
    return simulate_landmark_field(20, bearings=True)


def read_back(model, log, folder):
    path = folder / "model.toml"
    path.write_text(model_text(model, log), encoding="utf-8")
    return read_model(path, log)


@pytest.mark.parametrize(
    "model",
    [
        RobotModel(sensors=RANGES),
        RobotModel(sensors=(RangeNoise(outliers=True),)),
        RobotModel(GrowingIncrementNoise(), RANGES),
        RobotModel(Differential(), RANGES, fixed={"alpha4": 0.02}),
        RobotModel(Omni(), RANGES, priors={"alpha5": stats.uniform(loc=0.01, scale=2)}),
        RobotModel(sensors=RANGES, start=StartBelief((1.0, 1.0, 0.0), (0.1, 0.2, INF))),
        RobotModel(sensors=RANGES, start=StartBelief(mean=(1.0, 1.0, 0.5))),
        RobotModel(sensors=RANGES, start=StartBelief(std=(INF, INF, INF))),
        RobotModel(sensors=RANGES, fixed={"sigma_left": 0.02, "sigma_turn": 0.01}),
        RobotModel(
            sensors=RANGES,
            priors={"sigma_left": stats.lognorm(0.5, scale=0.1), "sigma_range": stats.uniform(loc=0.01, scale=2)},
        ),
        RobotModel(sensors=RANGES, priors={"sigma_left": stats.genextreme(-0.1, loc=1, scale=0.1)}),
    ],
    ids=lambda model: f"{type(model.motion).__name__}-{len(model.fixed)}-{len(model.priors)}-{model.start.std}",
)
def test_sonar_models_come_back_the_same(model, sonar_log, tmp_path):
    back = read_back(model, sonar_log, tmp_path)
    assert fingerprint(back.bind(sonar_log), {}) == fingerprint(model.bind(sonar_log), {})
    assert dict(back.fixed) == dict(model.fixed)


@pytest.mark.parametrize("sensor", [Lidar(), Lidar(model="beam", exponent=0.5), Lidar(max_beams=10, exponent=1.0)])
def test_lidar_models_come_back_the_same(sensor, tmp_path):
    log = simulate_lidar_room(5)
    back = read_back(RobotModel(Differential(), (sensor,)), log, tmp_path)
    assert isinstance(back.sensors[0].max_beams, int)
    assert fingerprint(back.bind(log), {}) == fingerprint(RobotModel(Differential(), (sensor,)).bind(log), {})


@pytest.mark.parametrize(
    "sensor",
    [
        LandmarkNoise(),
        LandmarkNoise(bearing=False),
        LandmarkNoise(range=False, outliers=True),
        LandmarkNoise(size_at_one_metre=900.0),
    ],
)
def test_landmark_models_come_back_the_same(sensor, landmark_log, tmp_path):
    model = RobotModel(sensors=(sensor,))
    back = read_back(model, landmark_log, tmp_path)
    assert back.sensors == model.sensors
    assert fingerprint(back.bind(landmark_log), {}) == fingerprint(model.bind(landmark_log), {})


def test_shapes_given_by_name_or_location_by_position_mean_the_same(sonar_log, tmp_path):
    priors = {"sigma_left": stats.gamma(a=2.0, scale=0.1), "sigma_turn": stats.uniform(0.0, np.float64(0.3))}
    back = read_back(RobotModel(sensors=RANGES, priors=priors), sonar_log, tmp_path)
    x = np.linspace(0.001, 0.29, 7)
    for name, prior in priors.items():
        found = next(parameter.prior for parameter in back.parameters if parameter.name == name)
        np.testing.assert_allclose(found.logpdf(x), prior.logpdf(x), rtol=1e-12)


@pytest.mark.parametrize("text", ["", 'motion = "increment"\nstart = "log"\n', "[priors]\n[fixed]\n"])
def test_what_is_left_out_follows_the_log(text, landmark_log, tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(text)
    back = read_model(path, landmark_log)
    assert fingerprint(back.bind(landmark_log), {}) == fingerprint(default_model(landmark_log).bind(landmark_log), {})


def test_flags_of_landmarks_follow_the_log(tmp_path):
    log = simulate_landmark_field(20)
    path = tmp_path / "model.toml"
    path.write_text("[sensors.landmarks]\noutliers = true\n")
    assert read_model(path, log).sensors == (LandmarkNoise(bearing=False, outliers=True),)


def test_the_text_is_toml_with_units(sonar_log):
    text = model_text(default_model(sonar_log), sonar_log)
    assert "[rad]" in text
    assert tomllib.loads(text)["priors"]["sigma_range"] == {"distribution": "gamma", "a": 2.0, "scale": 0.05}


MISTAKES = {
    'mottion = "increment"': ("'mottion'", "did you mean 'motion'"),
    'motion = "growin"': ("'motion'", "did you mean 'growing'"),
    "motion = 3": ("'motion'", "'growing' or 'differential' or 'omni', but got 3"),
    'start = "anywere"': ("'start'", "did you mean 'anywhere'"),
    "[start]\nmeen = [0, 0, 0]": ("'start.meen'", "did you mean 'mean'"),
    "[start]\nmean = [0, 0]": ("'start.mean'", "three numbers"),
    '[start]\nmean = [0, 0, "x"]': ("'start.mean'", "finite number, but got 'x'"),
    "[start]\nmean = [0, 0, inf]": ("'start.mean'", "finite number, but got inf"),
    "sensors = 1": ("'sensors'", "expected a table"),
    "[sensors]": ("'sensors'", "add one"),
    "[sensors.ranges]": ("'sensors.ranges'", "did you mean 'range'"),
    "[sensors.range]\noutliers = 1": ("'sensors.range.outliers'", "true or false, but got 1"),
    "[sensors.range]\nbias = true": ("'sensors.range.bias'", "but got 'bias'"),
    "[sensors.landmarks]\nbearings = true": ("'sensors.landmarks.bearings'", "did you mean 'bearing'"),
    "[sensors.landmarks]\nsize_at_one_metre = 0": ("'sensors.landmarks.size_at_one_metre'", "pixels > 0"),
    "priors = 2": ("'priors'", "expected a table"),
    '[priors.sigma_fwd]\ndistribution = "gamma"': ("'priors.sigma_fwd'", "did you mean 'sigma_forward'"),
    "[priors]\nsigma_left = 0.1": ("'priors.sigma_left'", "the key 'distribution'"),
    "[priors.sigma_left]\na = 1.0": ("'priors.sigma_left'", "the key 'distribution'"),
    '[priors.sigma_left]\ndistribution = "gama"': ("'priors.sigma_left.distribution'", "did you mean 'gamma'"),
    '[priors.sigma_left]\ndistribution = "poisson"': ("'priors.sigma_left.distribution'", "continuous"),
    "[priors.sigma_left]\ndistribution = 5": ("'priors.sigma_left.distribution'", "but got 5"),
    '[priors.sigma_left]\ndistribution = "gamma"': ("'priors.sigma_left'", "shape 'a' of gamma"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = 2\nscal = 1': ("sigma_left.scal'", "did you mean 'scale'"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = "2"': ("'priors.sigma_left.a'", "finite number, but got '2'"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = true': ("'priors.sigma_left.a'", "but got True"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = nan': ("'priors.sigma_left.a'", "but got nan"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = 2\nscale = -1': ("'priors.sigma_left'", "scale=-1"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = -2': ("'priors.sigma_left'", "gamma(-2)"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = 1e308': ("'priors.sigma_left.a'", "within 1e+09, but got 1e+308"),
    '[priors.sigma_left]\ndistribution = "gamma"\na = 1e-9': ("'priors.sigma_left'", "the quartiles of gamma(1e-09)"),
    '[priors.sigma_left]\ndistribution = "beta"\na = 1e-300\nb = 1e-300': ("'priors.sigma_left'", "quartiles of beta"),
    '[priors.sigma_left]\ndistribution = "pareto"\nb = 1e-3': ("'priors.sigma_left'", "within 1e+09"),
    f"[fixed]\nsigma_left = {'9' * 400}": ("'fixed.sigma_left'", "within 1e+09, but got 9999"),
    f"[fixed]\nsigma_left = {'9' * 9000}": ("TOML", "correct it"),
    "[start]\nmean = [1, 1, 0]\nstd = [0.1, 0, 0.1]": ("'start.std'", "three positive standard deviations"),
    "a = " + "[" * 9000: ("TOML", "correct it"),
    "[[effects]]\nname = 'beam-bias'\nbeams = [0.5]": ("'effects'", "one of the 8 places"),
    '[priors.sigma_left]\ndistribution = "norm"': ("'priors.sigma_left'", "reaches down to -inf"),
    "[fixed]\nsigma_lft = 0.1": ("'fixed.sigma_lft'", "did you mean 'sigma_left'"),
    '[fixed]\nsigma_left = "small"': ("'fixed.sigma_left'", "but got 'small'"),
    "[fixed]\nsigma_left = 0": ("sigma_left is fixed at 0", "no density"),
    "[fixed]\nsigma_left = -0.1": ("sigma_left is fixed at -0.1, outside",),
    '[fixed]\nsigma_left = 0.1\n[priors.sigma_left]\ndistribution = "expon"': ("'fixed.sigma_left'", "has both"),
    "motion = ": ("TOML", "Invalid value"),
    "[fixed]\n[fixed]": ("TOML", "line 2"),
}


@pytest.mark.parametrize(("text", "expected"), MISTAKES.items(), ids=[text.replace("\n", " ") for text in MISTAKES])
def test_every_mistake_is_told_in_one_line(text, expected, sonar_log, tmp_path):
    path = tmp_path / "mistaken.toml"
    path.write_text(text)
    with pytest.raises(ModelError) as caught:
        read_model(path, sonar_log)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    for part in expected:
        assert part in message


def test_an_outlier_weight_stays_between_zero_and_one(sonar_log, tmp_path):
    path = tmp_path / "model.toml"
    path.write_text('[sensors.range]\noutliers = true\n[priors.range_outlier_weight]\ndistribution = "expon"\n')
    with pytest.raises(ModelError, match=r"'priors\.range_outlier_weight'.*in \[0, 1\].*choose beta"):
        read_model(path, sonar_log)


def test_files_that_are_no_text_or_missing_are_told(sonar_log, tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.toml: expected a model file, but got 'No such file"):
        read_model(tmp_path / "nowhere.toml", sonar_log)
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match="in TOML"):
        read_model(path, sonar_log)


class OwnNoise(IncrementNoise):
    """A motion that no file can name."""


class OwnDistribution:
    """A prior that no file can name."""

    def logpdf(self, x):
        return -x

    def rvs(self, random_state=None):
        return 0.1

    def support(self):
        return 0.0, INF

    def mean(self):
        return 0.1

    def median(self):
        return 0.1


def test_what_a_file_cannot_hold_is_refused(sonar_log):
    with pytest.raises(ModelError, match=r"OwnNoise; register its class .*, or keep this model in Python"):
        model_text(RobotModel(OwnNoise(), RANGES), sonar_log)
    with pytest.raises(ModelError, match=r"prior of sigma_left.*OwnDistribution"):
        model_text(RobotModel(sensors=RANGES, priors={"sigma_left": OwnDistribution()}), sonar_log)
    with pytest.raises(ModelError, match="at least one sensor"):
        model_text(RobotModel(), sonar_log)
    other = (Parameter("sigma_x", "m", stats.expon()),)
    with pytest.raises(ModelError, match="IncrementNoise"):
        model_text(RobotModel(IncrementNoise(other), RANGES), sonar_log)


def test_a_landmark_that_this_log_never_saw_is_still_a_place(landmark_log, tmp_path):
    """A model that was found on one drive is used on another, on which a landmark may not have come by."""
    dataset = landmark_log.dataset.copy(deep=True)
    for name in ("landmark_range", "landmark_bearing"):
        values = dataset[name].values.copy()
        values[:, 2] = np.nan
        dataset[name] = (("time", "landmark"), values)
    blind = RobotLog(dataset, "blind.nc")
    path = tmp_path / "model.toml"
    path.write_text('[[effects]]\nname = "landmark-moved"\nlandmarks = [2]\n')
    assert read_model(path, blind).effects[0].where == {"landmarks": (2,)}
    path.write_text('[[effects]]\nname = "landmark-moved"\nlandmarks = [99]\n')
    with pytest.raises(ModelError, match="places that the log has, but got 99"):
        read_model(path, blind)


FORMULA = '[[effects]]\nname = "formula"\ncarrier = "turn"\nterms = ["speed*k"]\n'


def test_a_formula_by_hand_needs_no_more_than_carrier_and_terms(sonar_log, tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(FORMULA + "constants = { k = 2.0 }\n")
    (effect,) = read_model(path, sonar_log).effects
    assert effect.name == "formula: turn += c*speed*k"
    # The prior is as wide as three clear changes of 0.04 rad at the usual size of the term on this log.
    usual = np.sqrt(np.mean((2.0 * np.hypot(*sonar_log.odometry[1:, :2].T) / np.diff(sonar_log.times)) ** 2))
    assert effect.parameters[0].prior.std() == pytest.approx(3.0 * 0.04 / usual)


@pytest.mark.parametrize(
    ("text", "expected"),
    {
        '[[effects]]\nname = "formula"\nterms = ["speed"]': ("'effects.carrier'", "but got None"),
        '[[effects]]\nname = "formula"\ncarrier = "turns"\nterms = ["speed"]': ("'effects.carrier'", "mean 'turn'"),
        '[[effects]]\nname = "formula"\ncarrier = "turn"\nterms = "speed"': ("'effects.terms'", "a list of texts"),
        '[[effects]]\nname = "formula"\ncarrier = "turn"\nterms = ["sped"]': ("'effects'", "did you mean 'speed'"),
        FORMULA: ("'effects'", "expected a known variable, but got 'k'"),
        FORMULA + "constants = { k = nan }": ("'effects.constants.k'", "finite number"),
        FORMULA + "constants = 3": ("'constants'", "expected a table"),
        FORMULA + "constants = { k = 1 }\nwindow = [3]": ("'effects.window'", "[begin, end]"),
        FORMULA + "constants = { k = 1 }\nwindow = [3, 2]": ("'effects'", "begin < end"),
        FORMULA + "constants = { k = 1 }\nwindos = [3, 4]": ("'effects.windos'", "did you mean 'window'"),
        FORMULA + "constants = { k = 1 }\ncoefficients = []": ("'effects.coefficients'", "a list of texts"),
        FORMULA + 'constants = { k = 1 }\ncoefficients = ["a", "b"]': ("'effects'", "one coefficient for each"),
        FORMULA + 'constants = { k = 1 }\ncoefficients = ["sigma_turn"]': ("'sigma_turn'", "occur twice"),
    }.items(),
)
def test_mistakes_in_formulas_are_told_in_one_line(text, expected, sonar_log, tmp_path):
    test_every_mistake_is_told_in_one_line(text, expected, sonar_log, tmp_path)
