"""A sensor, a motion model and an effect of another package: everything that pmcl does with its own, it does with them.

The package is :mod:`rooms.compass` and :mod:`rooms.isotropic`, which use public names alone. A robot with nothing but a
compass is a linear and Gaussian model of its heading, so its posterior is known exactly.
"""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rooms import compass, isotropic
from rooms.compass import COMPASS_OFFSET, Compass
from scipy import stats

import pmcl
from pmcl import registry
from pmcl.errors import LogError, ModelError
from pmcl.filtering.particle_filter import make_rng
from pmcl.geometry import wrap
from pmcl.localization import OnlineLocalizer
from pmcl.logs import RobotLog
from pmcl.models import (
    ChannelReading,
    Misreading,
    QuickReadings,
    RobotModel,
    default_model,
    read_model,
    register_motion,
    register_sensor,
)
from pmcl.models.model_file import model_of_text, model_text
from pmcl.models.sensor import sensor_of
from pmcl.posterior.access import log_contents
from pmcl.preflight.check import preflight
from pmcl.registry import EFFECTS, MOTIONS, SENSORS
from pmcl.reports import write_report
from pmcl.reports.residual_figures import residual_channels
from pmcl.simulations.landmark_field import simulate_landmark_field

TURN_NOISE, COMPASS_NOISE, OFFSET = 0.02, 0.05, 0.3
KNOWN = {"sigma_forward": 0.02, "sigma_left": 0.02}
MODEL = RobotModel(sensors=(Compass(),), fixed=KNOWN, effects=(COMPASS_OFFSET,))


@pytest.fixture(autouse=True)
def added(only_own_parts):
    """Register the sensor, the motion and the effect as a script does, for each test."""
    register_sensor("compass")(Compass)
    register_motion("isotropic")(isotropic.IsotropicNoise)
    registry.register(EFFECTS, "compass-offset", COMPASS_OFFSET)


def compass_log(offset=0.0, seed=1, rows=150):
    """Simulate a drive in gentle bends; the compass is read in every row but one."""
    rng = np.random.default_rng(seed)
    odometry = np.zeros((rows, 3))
    odometry[1:, 0], odometry[1:, 2] = 0.1, 0.1 * np.sin(0.2 * np.arange(1, rows))
    noise = TURN_NOISE * rng.standard_normal(rows)
    noise[0] = 0.01 * rng.standard_normal()
    heading = np.cumsum(odometry[:, 2] + noise)
    reading = wrap(heading + offset + COMPASS_NOISE * rng.standard_normal(rows))
    reading[5] = np.nan
    return RobotLog.build(
        time=0.5 * np.arange(rows), odometry=odometry, variables={"compass": reading},
        start_mean=np.zeros(3), start_std=[0.05, 0.05, 0.01], robot="compass robot",
        true_poses=np.column_stack([np.full((rows, 2), np.nan), wrap(heading)]),
    )  # fmt: skip


def field_log(offset=0.0, seed=1, rows=150):
    """Simulate a drive between landmarks, which tell the heading all the time, and add a compass.

    Where the compass is alone, its offset shows in the first rows only: later the path follows the compass.
    """
    log = simulate_landmark_field(rows, seed, bearings=True)
    noise = COMPASS_NOISE * np.random.default_rng(seed).standard_normal(log.n_steps)
    return RobotLog.from_dataset(log.dataset.assign(compass=("time", wrap(log.true_poses[:, 2] + offset + noise))))


@pytest.fixture(scope="module")
def calibrated():
    """The posterior of a robot whose compass is off, effect included."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registry._added, SENSORS, {"compass": Compass})
        patch.setitem(registry._added, EFFECTS, {"compass-offset": COMPASS_OFFSET})
        return pmcl.calibrate(compass_log(OFFSET), MODEL, draws=1000, chains=2, seed=3)


def test_the_modules_use_public_names_only():
    assert len(inspect.getsource(compass).splitlines()) <= 150
    for module in (compass, isotropic):
        for line in inspect.getsource(module).splitlines():
            words = line.split()
            if words[:1] != ["from"] or not words[1].startswith("pmcl"):
                continue
            public = __import__(words[1], fromlist=["__all__"])
            names = [word.strip(",") for word in words[3:]]
            assert words[1] == "pmcl" or set(names) <= set(public.__all__), line


# The log.


def test_the_variable_is_part_of_the_format(tmp_path):
    log = compass_log()
    log.write(tmp_path / "log.nc")
    back = pmcl.read_log(tmp_path / "log.nc")
    np.testing.assert_array_equal(back.variable("compass"), log.variable("compass"))
    assert back.dataset["compass"].attrs["units"] == "rad"
    assert back.n_readings == 149
    assert back.fingerprint() == log.fingerprint() != compass_log(seed=2).fingerprint()
    assert back.select(10, 20).variable("compass").shape == (10,)


def test_impossible_readings_are_told():
    good = {"time": [0.0, 1.0], "odometry": np.zeros((2, 3))}
    with pytest.raises(LogError, match=r"expected 'compass' finite or NaN .*, got inf in row 1 \(time 1 s\)"):
        RobotLog.build(**good, variables={"compass": [0.1, np.inf]})
    with pytest.raises(LogError, match=r"expected 'compass' of shape \(time\), got \(1, 2\)"):
        RobotLog.build(**good, variables={"compass": [[0.1, 0.2]]})
    with pytest.raises(LogError, match=r"expected at least one of range, .*compass, got none"):
        RobotLog.build(**good)
    with pytest.raises(LogError, match="variables of registered sensors, got 'compas': did you mean 'compass'"):
        RobotLog.build(**good, variables={"compas": [0.1, 0.2]})
    with pytest.raises(LogError, match="'range' as an argument of its own"):
        RobotLog.build(**good, variables={"range": [[0.1], [0.2]]})


def test_a_stuck_compass_is_implausible():
    sound = compass_log()
    assert preflight(sound) == ()
    stuck = np.array(sound.variable("compass"))
    stuck[60:100] = stuck[60]
    dataset = sound.dataset.assign(compass=("time", stuck))
    assert [finding.name for finding in preflight(RobotLog.from_dataset(dataset))] == ["stuck-sensor"]


class QuickCompass(QuickReadings):
    """Headings for a quick filter, and the mistake that they are a navigator's: clockwise from north."""

    def __init__(self, heading, std):
        self.heading, self.std = heading, std

    @property
    def rows(self):
        return ~np.isnan(self.heading)

    def channels(self, row):
        yield ChannelReading(("compass", 0), self.heading[row], -np.pi, np.pi)

    def mistakes(self):
        advice = "subtract them from pi / 2"
        yield Misreading("compass-from-north", "the headings seem to be counted clockwise from north", advice, True)

    def under(self, ways):
        from_north = np.array([bool(way.change) for way in ways])

        def log_density(row, way, level, x, y, heading):
            read = np.where(from_north[way], np.pi / 2.0 - self.heading[row], self.heading[row])
            hit = stats.norm.pdf(wrap(read[:, None] - heading), scale=level[:, None] * self.std)
            return np.log(0.95 * hit + 0.05 / (2.0 * np.pi))

        return log_density


class CompassWithPreflight(Compass):
    """The same sensor, which says how a quick filter reads it."""

    @staticmethod
    def quick_readings(log, usual):
        return QuickCompass(log.variable("compass"), usual["sigma_compass"])


def test_the_preflight_asks_the_sensor_for_mistakes(monkeypatch):
    """A sensor without `quick_readings` is left out; with it, its own mistakes are named."""
    sound = compass_log()
    from_north = wrap(np.pi / 2.0 - sound.variable("compass"))
    wrong = RobotLog.from_dataset(sound.dataset.assign(compass=("time", from_north)))
    assert preflight(wrong) == ()
    monkeypatch.setitem(registry._added[SENSORS], "compass", CompassWithPreflight)
    assert preflight(sound) == ()
    assert [finding.name for finding in preflight(wrong)] == ["compass-from-north"]


# The model.


def test_the_default_model_and_its_file(tmp_path):
    log = compass_log()
    assert default_model(log).sensors == (Compass(),)
    text = model_text(MODEL, log)
    assert model_text(model_of_text(text, log), log) == text
    path = tmp_path / "model.toml"
    path.write_text(
        'motion = "isotropic"\n[sensors.compass]\n[[effects]]\nname = "compass-offset"\n[fixed]\nsigma_step = 0.02\n'
    )
    model = read_model(path, log)
    assert model.sensors == (Compass(),)
    assert [p.name for p in model.parameters] == ["sigma_turn", "sigma_compass", "compass_offset"]
    text = model_text(model, log)
    assert "[sensors.compass] # absolute headings" in text
    assert model_text(model_of_text(text, log), log) == text
    for text, message in (
        ("[sensors.compas]", "did you mean 'compass'"),
        ("[sensors.compass]\nheight = 2", "key 'sensors.compass.height'"),
        ("[sensors.compass]\n[fixed]\nsigma_compass = 0", "sigma_compass is fixed at 0"),
        ('[sensors.compass]\n[priors.sigma_compass]\ndistribution = "norm"', "numbers >= 0"),
        ('motion = "isotropc"', "did you mean 'isotropic'"),
    ):
        with pytest.raises(ModelError, match=message):
            model_of_text(text, log)


def test_the_motion_is_the_increments_motion_with_equal_noise(rng):
    log = compass_log()
    motion = isotropic.IsotropicNoise()
    own = RobotModel(motion, (Compass(),)).bind(log)
    usual = RobotModel(sensors=(Compass(),)).bind(log)
    np.testing.assert_array_equal(
        own.tables(np.array([0.03, 0.02, 0.05]))[0].motion.std,
        usual.tables(np.array([0.03, 0.03, 0.02, 0.05]))[0].motion.std,
    )
    path = rng.normal(size=(log.n_steps, 3))
    theta = np.array([0.03, 0.02])
    found = own.parts[0][1].statistics(own.tables(np.append(theta, 0.05))[0].motion, path, None, np.arange(2), theta)
    wide = usual.parts[0][1].statistics(
        usual.tables(np.array([0.03, 0.03, 0.02, 0.05]))[0].motion, path, None, np.arange(3), theta[[0, 0, 1]]
    )
    sigma = theta[[0, 0, 1]]
    assert np.sum(found.counts * np.log(theta) + 0.5 * found.squares / theta**2) == pytest.approx(
        np.sum(wide.counts * np.log(sigma) + 0.5 * wide.squares / sigma**2)
    )


def test_simulated_readings_have_offset_noise_and_gaps():
    log = compass_log()
    bound = MODEL.bind(log)
    (table,) = bound.tables(np.array([TURN_NOISE, COMPASS_NOISE, OFFSET]))[0].sensors
    path = np.zeros((log.n_steps, 3))
    path[:, 2] = np.linspace(0.0, 20.0, log.n_steps)
    dataset = log.dataset.copy(deep=True)
    sensor = sensor_of(table)
    sensor.store(sensor.simulate(table, path, make_rng(5)), dataset)
    error = wrap(dataset["compass"].values - path[:, 2] - OFFSET)
    assert np.isnan(error[5])
    assert np.count_nonzero(np.isnan(error)) == 1
    # 149 draws: mean and standard deviation within five standard errors.
    assert abs(np.nanmean(error)) < 5.0 * COMPASS_NOISE / np.sqrt(149.0)
    assert np.nanstd(error) == pytest.approx(COMPASS_NOISE, rel=5.0 / np.sqrt(2.0 * 149.0))


# Calibration.


def test_sums_of_squares_have_the_density_of_the_readings(rng):
    log = compass_log(OFFSET)
    bound = MODEL.bind(log)
    path = np.cumsum(0.3 * rng.standard_normal((log.n_steps, 3)), axis=0)
    reading = log.variable("compass")

    def log_density(sigma, offset):
        error = wrap(reading - offset - path[:, 2])
        return float(np.nansum(stats.norm(scale=sigma).logpdf(error)))

    def by_sums(sigma, offset):
        (table,) = bound.tables(np.array([TURN_NOISE, sigma, offset]))[0].sensors
        sums = bound.parts[0][2].statistics(table, path, None, np.array([1]), np.array([sigma]))
        return float(-sums.counts[0] * np.log(sigma) - 0.5 * sums.squares[0] / sigma**2)

    for offset in (0.0, OFFSET):
        expected = log_density(0.05, offset) - log_density(0.08, offset)
        assert by_sums(0.05, offset) - by_sums(0.08, offset) == pytest.approx(expected)


def exact_moments(log):
    """Mean and standard deviation of (sigma_turn, sigma_compass, compass_offset), by Kalman filters on a grid.

    The state is (heading, offset); the prior of the offset is a part of the first state.
    """
    priors = [parameter.prior for parameter in MODEL.parameters]
    turn, sigma = np.meshgrid(np.linspace(0.002, 0.08, 70), np.linspace(0.025, 0.09, 70), indexing="ij")
    logp = priors[0].logpdf(turn) + priors[1].logpdf(sigma)
    mean = np.zeros((2, *turn.shape))
    cov = np.zeros((2, 2, *turn.shape))
    cov[0, 0], cov[1, 1] = log.start_std[2] ** 2, priors[2].std() ** 2
    for t, reading in enumerate(log.variable("compass")):
        if t > 0:
            mean[0] += log.odometry[t, 2]
            cov[0, 0] += turn**2
        if np.isnan(reading):
            continue
        error = wrap(reading - mean.sum(axis=0))
        gain = cov.sum(axis=0)
        total = gain.sum(axis=0) + sigma**2
        logp -= 0.5 * np.log(total) + 0.5 * error**2 / total
        mean = mean + gain * error / total
        cov = cov - gain[:, None] * gain[None, :] / total
    weight = np.exp(logp - logp.max())
    weight /= weight.sum()
    first = np.array([np.sum(weight * value) for value in (turn, sigma, mean[1])])
    second = np.array([np.sum(weight * value) for value in (turn**2, sigma**2, mean[1] ** 2 + cov[1, 1])])
    return first, np.sqrt(second - first**2)


@pytest.mark.slow
def test_the_posterior_is_exact_and_transport_moves_are_accepted(calibrated):
    names = ("sigma_turn", "sigma_compass", "compass_offset")
    draws = np.array([calibrated.posterior[name].values.ravel() for name in names])
    mean, spread = exact_moments(compass_log(OFFSET))
    # 400 effective draws or more: five Monte Carlo errors are a quarter of a standard deviation.
    np.testing.assert_array_less(np.abs(draws.mean(axis=1) - mean) / spread, 0.25)
    np.testing.assert_allclose(draws.std(axis=1), spread, rtol=0.2)
    statistics = calibrated.sample_stats
    assert float(statistics["transport_jump_rate"].mean()) > 0.3
    assert pmcl.verdict(calibrated).converged
    assert pmcl.verdict(calibrated).adequate


@pytest.mark.slow
def test_the_posterior_file_holds_the_readings(calibrated):
    (held,) = log_contents(calibrated)
    assert held.readings == 149
    assert calibrated.posterior_predictive["compass"].shape[2:] == (149,)
    spread = calibrated.posterior_predictive["compass"].values.std(axis=(0, 1))
    assert 0.8 * COMPASS_NOISE < np.median(spread) < 2.0 * COMPASS_NOISE
    assert calibrated.predictive_check["residual_compass"].shape == (150,)


@pytest.mark.slow
def test_the_report_shows_the_sensor(calibrated, tmp_path):
    write_report(calibrated, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    for words in ("sigma_compass", "compass_offset", "149 readings"):
        assert words in page, words
    assert residual_channels(calibrated, 0, 1) == {"residual_compass": "compass headings"}


# Localization.


@pytest.mark.slow
def test_localization_off_and_on_line_are_the_same(calibrated):
    log = compass_log(OFFSET)
    track = pmcl.localize(log, model=MODEL, posterior=calibrated, method="mean", particles=200, seed=2)
    robot = OnlineLocalizer(log, model=MODEL, posterior=calibrated, method="mean", particles=200, seed=2)
    reading = log.variable("compass")
    estimates = [robot.update(log.times[t], log.odometry[t], compass=reading[t]) for t in range(log.n_steps)]
    np.testing.assert_array_equal([estimate.mean for estimate in estimates], track.pose_mean)
    np.testing.assert_array_equal([estimate.log_score for estimate in estimates], track.log_score)
    truth = log.true_poses[:, 2]
    alone = np.cumsum(log.odometry[:, 2])
    error, drift = (np.sqrt(np.mean(wrap(found - truth) ** 2)) for found in (track.pose_mean[:, 2], alone))
    assert error < 0.03 < drift
    with pytest.raises(LogError, match="expected no 'range'"):
        robot.update(100.0, np.zeros(3), range=[1.0])


# Criticism.


@pytest.mark.long
def test_the_critic_finds_the_offset():
    found = pmcl.criticize(field_log(OFFSET), joint=False, workers=1)
    assert [effect.name for effect in found.effects] == ["compass-offset"]
    offset = found.effects[0].parameters["compass_offset"]
    assert abs(offset.mean - OFFSET) < 4.0 * offset.sd < OFFSET


@pytest.mark.long
def test_the_critic_finds_nothing_where_there_is_no_offset():
    assert pmcl.criticize(field_log(), joint=False, workers=1).effects == ()


# Installed packages.

_INSTALLED = """
import numpy as np, pmcl
from pmcl.models import default_model
from pmcl.models.effects import effect_named
from pmcl.models.model_file import model_of_text
log = pmcl.RobotLog.build(time=[0.0, 1.0], odometry=np.zeros((2, 3)), variables={"compass": [0.1, 0.2]},
                          start_mean=np.zeros(3), start_std=np.ones(3))
model = model_of_text('motion = "isotropic"\\n[sensors.compass]\\n[[effects]]\\nname = "compass-offset"', log)
print(*(type(part).__name__ for part in (model.motion, *model.sensors)), model.effects[0].name)
"""


def installed(folder: Path, entries: str) -> dict[str, str]:
    """Put a package with entry points into a folder, as an installer does; return the environment that sees it."""
    for module in (compass, isotropic):
        (folder / f"compassworks_{module.__name__.rpartition('.')[2]}.py").write_text(inspect.getsource(module))
    metadata = folder / "compassworks-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: compassworks\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entries)
    roots = (str(folder), str(Path(pmcl.__file__).parents[1]), os.environ.get("PYTHONPATH", ""))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(root for root in roots if root)}


def test_installed_packages_add_a_sensor_a_motion_and_an_effect(tmp_path):
    environment = installed(
        tmp_path,
        "[pmcl.sensors]\ncompass = compassworks_compass:Compass\n"
        "[pmcl.motions]\nisotropic = compassworks_isotropic:IsotropicNoise\n"
        "[pmcl.effects]\noffset = compassworks_compass:COMPASS_OFFSET\n",
    )
    done = subprocess.run([sys.executable, "-c", _INSTALLED], env=environment, capture_output=True, text=True)
    assert done.stdout == "IsotropicNoise Compass compass-offset\n", done.stderr


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ("[pmcl.sensors]\nrange = compassworks_compass:Compass\n", "expected another name than 'range'"),
        ("[pmcl.sensors]\ncompass = compassworks_compass:Nothing\n", "loading compassworks_compass:Nothing failed"),
        ("[pmcl.sensors]\ncompass = compassworks_compass:COMPASS_OFFSET\n", "compassworks_compass:COMPASS_OFFSET is"),
        ("[pmcl.motions]\nother = compassworks_compass:COMPASS_OFFSET\n", "expected a class of motion models, but"),
    ],
)
def test_packages_that_cannot_be_used_are_named(entries, message, tmp_path, monkeypatch):
    installed(tmp_path, entries)
    monkeypatch.syspath_prepend(str(tmp_path))
    registry._of_packages.cache_clear()
    try:
        with pytest.raises(ModelError, match=f"entry point '.*' of compassworks: .*{message}") as caught:
            registry.registered(MOTIONS if "motions" in entries else SENSORS)
        assert "\n" not in str(caught.value)
    finally:
        monkeypatch.undo()
        registry._of_packages.cache_clear()


def test_names_that_are_taken_are_refused():
    with pytest.raises(ModelError, match="'range' is registered already"):
        register_sensor("range")(Compass)
    with pytest.raises(ModelError, match=r"a class that derives from pmcl\.models\.Sensor, but got a"):
        registry.register(SENSORS, "odd", 3)
