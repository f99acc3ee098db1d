"""Every public function refuses what it cannot use: at once, by a PmclError of one line that says what to do.

Each argument is given values that hypothesis picks from a list of all that users get wrong: zero, negative, not finite,
huge, fractional, of another type, empty. Which of them are right is said here a second time, in plain terms. A right
value must pass the checks: the work behind them is replaced by a signal that it was reached.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import stats

import pmcl
from pmcl.calibration import Ensemble
from pmcl.comparison.compare import compare
from pmcl.errors import PmclError
from pmcl.localization.online import OnlineLocalizer
from pmcl.localization.options import FilterOptions
from pmcl.models.effects.selection import effect_named


class Reached(Exception):
    """The checks have let the arguments pass."""


class NotComparable:
    """An object that refuses nearly everything that a careless check would try."""

    def __eq__(self, other):
        raise TypeError("not comparable")

    def __bool__(self):
        raise TypeError("no truth value")

    __hash__ = None

    def __repr__(self):
        raise TypeError("cannot be written")


VALUES = [
    0, 1, 2, 3, 60, -1, -(10**30), 10**12, 10**30, 2**64 - 1, 2**64, 10**400,
    0.0, -0.0, 0.05, 0.5, 1.0, 2.5, -1.5, 60.0, 1e12, 1e300, -1e300, math.nan, math.inf, -math.inf,
    True, False, np.True_, None, "", "x", "25", "a\nlong text " * 9, "file\0name", b"", b"bytes",
    [], (), {}, [1], [None], ["x"], {"x": 1}, {"sigma_range": "x"}, {"sigma_range": math.nan}, {1: 2},
    {"sigma_range": 0.1}, 1j, object(), object, NotComparable(),
    np.array([]), np.array(3), np.array([1, 2]), np.array(math.nan), np.int64(5), np.int8(-3),
    np.float32(0.25), np.float64(math.nan), np.timedelta64(3, "s"), stats.gamma(2.0), Path("no/such/file"),
]  # fmt: skip


def whole(least, most=10**9):
    """Right values are whole numbers, by type, between limits."""

    def right(value):
        return type(value) in (int, np.int64, np.int8) and least <= value <= most

    return right


def real(low, high, *, open_low=False, open_high=False):
    """Right values are finite numbers between limits."""

    def right(value):
        if type(value) not in (int, float, np.int64, np.int8, np.float32, np.float64):
            return False
        if isinstance(value, int) and abs(value) > 10**300:
            return False
        above = value > low if open_low else value >= low
        below = value < high if open_high else value <= high
        return bool(math.isfinite(value) and above and below)

    return right


def one_of(*choices):
    return lambda value: isinstance(value, str) and value in choices


def flag(value):
    return isinstance(value, bool | np.bool_)


def optional(right):
    return lambda value: value is None or right(value)


def none(value):
    return value is None


def nothing(value):
    return False


def seed(value):
    return whole(0, 2**64 - 1)(value)


# The greatest count that is right, as long as memory holds it; these logs are so small that it may.
FEW = 10**9


@pytest.fixture(scope="module")
def log():
    return pmcl.simulate_amigobot(60.0, seed=3)


@pytest.fixture(scope="module")
def short_log():
    return pmcl.simulate_amigobot(4.0, seed=3)


CALIBRATE = {
    "logs": nothing, "model": none, "method": one_of("particle-gibbs", "ensemble"),
    "draws": whole(1, FEW), "chains": whole(1, FEW), "trajectories": whole(1), "seed": seed,
    "pool": none, "checkpoint": optional(lambda value: isinstance(value, Path) or value in ("x", "25")),
    "resume": flag, "progress": flag, "check": flag,
}  # fmt: skip
PARTICLE_GIBBS = {
    "kernel": one_of("conditional", "smoothing"), "particles": optional(whole(2)), "metropolis_steps": whole(1),
    "transport_moves": optional(whole(0)), "data_rate": optional(whole(1)), "burn_in_particles": whole(2),
    "settling_sweeps": whole(1), "sweeps_per_draw": optional(whole(1)),
    "tuning_sweeps": lambda value: isinstance(value, tuple) and not value,
}  # fmt: skip
ENSEMBLE = {"particles": optional(whole(2)), "burn_in": optional(whole(1))}
CRITICIZE = {
    "log": nothing, "model": none, "effects": optional(lambda value: isinstance(value, list | tuple) and not value),
    "particles": whole(50, FEW), "seed": seed, "level": real(0.0, 0.5, open_low=True, open_high=True),
    "simulations": whole(15), "paths": whole(1), "rounds": whole(1), "joint": flag, "draws": whole(1),
    "workers": optional(whole(1)), "progress": flag,
}  # fmt: skip
LOCALIZE = {
    "log": nothing, "model": none, "posterior": none, "method": one_of("mean", "map", "posterior", "prior"),
    "theta": optional(lambda value: isinstance(value, dict) and value in ({}, {"sigma_range": 0.1})),
    "particles": whole(2, FEW), "seed": seed, "options": none,
}  # fmt: skip
MANY = LOCALIZE | {"repetitions": whole(1, FEW), "threads": optional(whole(1)), "pool": none}
ONLINE = {name: right for name, right in LOCALIZE.items() if name != "log"} | {"robot": nothing, "memory": whole(3)}
OPTIONS = {
    "draws": optional(whole(1)), "draws_per_reading": optional(whole(1)), "scheme": nothing,
    "threshold": real(0.0, 1.0), "annealed": flag, "recover": flag, "least_particles": optional(whole(2)),
    "start_particles": optional(whole(2)),
}  # fmt: skip
COMPARE = {
    "log": nothing, "methods": nothing, "model": none, "seconds": real(0.0, math.inf, open_low=True),
    "chains": whole(2), "seed": seed, "held_out": real(0.0, 0.5), "progress": flag,
}  # fmt: skip
SIMULATE = {
    "duration": real(2.0, 1e9), "seed": seed,
    "theta": optional(lambda value: isinstance(value, dict) and value in ({}, {"sigma_range": 0.1})),
    "effects": lambda value: value in ([], (), ["x"]), "hide_effects": flag,
}  # fmt: skip
MOVE = {
    "bound": nothing, "kernel": one_of("conditional", "smoothing"), "particles": whole(2), "metropolis_steps": whole(0),
    "transport_moves": optional(whole(0)), "sweeps": optional(whole(1)), "data_rate": whole(0), "gain": real(0.0, 1.0),
}  # fmt: skip
PARAMETER = {
    "name": lambda value: isinstance(value, str) and bool(value), "unit": lambda value: isinstance(value, str),
    "prior": lambda value: hasattr(value, "logpdf"), "description": lambda value: isinstance(value, str),
}  # fmt: skip
MODEL = {
    "motion": nothing, "start": nothing, "sensors": lambda value: isinstance(value, list | tuple) and not value,
    "effects": lambda value: isinstance(value, list | tuple) and not value,
    "priors": lambda value: isinstance(value, dict) and not value,
    "fixed": lambda value: isinstance(value, dict) and not value,
}  # fmt: skip
SELECT = {"start": whole(0, 59), "stop": whole(1, 60)}


def reach(*arguments, **settings):
    raise Reached


@pytest.fixture(scope="module")
def functions(log, short_log):
    """For each name: the function, its right arguments, and which values of each are right."""
    bound = pmcl.default_model(log).bind(log)
    return SimpleNamespace(
        calibrate=(pmcl.calibrate, {"logs": log}, CALIBRATE),
        criticize=(pmcl.criticize, {"log": log}, CRITICIZE),
        localize=(pmcl.localize, {"log": log, "method": "prior"}, LOCALIZE),
        localize_many=(pmcl.localize_many, {"log": log, "method": "prior"}, MANY),
        OnlineLocalizer=(OnlineLocalizer, {"robot": log, "method": "prior"}, ONLINE),
        FilterOptions=(FilterOptions, {}, OPTIONS),
        compare=(compare, {"log": log, "methods": "plain"}, COMPARE),
        ParticleGibbs=(pmcl.ParticleGibbs, {}, PARTICLE_GIBBS),
        Ensemble=(Ensemble, {}, ENSEMBLE),
        simulate_amigobot=(pmcl.simulate_amigobot, {"duration": 4.0}, SIMULATE | {"waypoints": none, "room": none}),
        simulate_aibo=(
            pmcl.simulate_aibo, {"duration": 4.0}, SIMULATE | {"theta": lambda value: value in (None, {})},
        ),
        ParticleGibbsMove=(pmcl.ParticleGibbsMove, {"bound": bound}, MOVE),
        Parameter=(pmcl.Parameter, {"name": "a", "unit": "m", "prior": stats.gamma(2.0)}, PARAMETER),
        RobotModel=(pmcl.RobotModel, {}, MODEL),
        default_model=(pmcl.default_model, {"log": log}, {"log": nothing, "outliers": flag}),
        select=(log.select, {"start": 0, "stop": 60}, SELECT),
        read_log=(pmcl.read_log, {"path": "x"}, {"path": nothing}),
        read_posterior=(pmcl.read_posterior, {"path": "x"}, {"path": nothing}),
        verdict=(pmcl.verdict, {"data": None}, {"data": nothing}),
        WallMap=(pmcl.WallMap, {"segments": np.zeros((1, 2, 2))}, {"segments": nothing}),
        LandmarkMap=(pmcl.LandmarkMap, {"positions": np.zeros((1, 2))}, {
            "positions": nothing,
            "names": lambda value: isinstance(value, list | tuple | np.ndarray) and len(value) < 2,
        }),
    )  # fmt: skip


NAMES = (
    "calibrate", "criticize", "localize", "localize_many", "OnlineLocalizer", "FilterOptions", "compare",
    "ParticleGibbs", "Ensemble", "simulate_amigobot", "simulate_aibo", "ParticleGibbsMove", "Parameter", "RobotModel",
    "default_model", "select", "read_log", "read_posterior", "verdict", "WallMap", "LandmarkMap",
)  # fmt: skip


@pytest.fixture
def no_work(monkeypatch):
    """Replace what functions do after their checks."""
    monkeypatch.setattr("pmcl.sampling.particle_gibbs.run_session", reach)
    monkeypatch.setattr("pmcl.sampling.ensemble.run_session", reach)
    monkeypatch.setattr("pmcl.criticism.lost_filter.Search", reach)
    monkeypatch.setattr("pmcl.localization.setup.Tracker", reach)
    monkeypatch.setattr("pmcl.comparison.compare._compile", reach)
    monkeypatch.setattr("pmcl.simulations.amigobot.drive", reach)
    monkeypatch.setattr("pmcl.simulations.aibo.drive", reach)


@pytest.mark.parametrize("name", NAMES)
@given(data=st.data())
@settings(
    max_examples=100, deadline=None, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
def test_each_argument_is_right_or_refused_in_one_line(name, functions, no_work, data):
    function, arguments, rules = getattr(functions, name)
    argument = data.draw(st.sampled_from(sorted(rules)))
    value = VALUES[data.draw(st.integers(0, len(VALUES) - 1))]
    try:
        function(**{**arguments, argument: value})
    except PmclError as error:
        refused = str(error)
    except Reached:
        refused = ""
    else:
        refused = ""
    right = _is_right(rules[argument], value)
    if refused:
        assert "\n" not in refused
        assert any(word in refused for word in ("expected", "must be", "but the model's parameters are"))
        assert len(refused) < 500
        # A right value may still be missing something beside it, or lead beyond what the log holds.
        assert not right or argument in ("method", "stop", "checkpoint"), f"{argument} = {value!r}: {refused}"
    else:
        assert right, f"{argument} passed"


def _is_right(right, value):
    try:
        return bool(right(value))
    except (TypeError, ValueError):
        return False


BUILD = ("time", "odometry", "ranges", "beam_poses", "max_range", "landmark_range", "landmark_bearing", "landmark_size",
         "size_at_one_metre", "landmark_time_offset", "landmark_sensor_pose", "landmarks", "walls", "start_mean",
         "start_std", "true_poses", "true_theta", "robot", "source", "seed", "attributes", "where")  # fmt: skip


@given(argument=st.sampled_from(BUILD), k=st.integers(0, len(VALUES) - 1))
@settings(max_examples=200, deadline=None, derandomize=True, database=None)
def test_a_log_is_built_right_or_refused_in_one_line(argument, k):
    arguments = {
        "time": [0.0, 1.0, 2.0], "odometry": np.zeros((3, 3)), "landmarks": [[1.0, 2.0]],
        "landmark_range": [[1.0], [2.0], [np.nan]], "ranges": np.ones((3, 1)), "beam_poses": np.zeros((1, 3)),
        "max_range": 5.0, "walls": [[[-9.0, -9.0], [9.0, 9.0]]],
    }  # fmt: skip
    try:
        refused = ""
        assert pmcl.RobotLog.build(**{**arguments, argument: VALUES[k]}).n_steps == 3
    except PmclError as error:
        refused = str(error)
    assert "\n" not in refused


@given(k=st.integers(0, len(VALUES) - 1), argument=st.sampled_from(["time", "odometry", "range", "landmark_range"]))
@settings(max_examples=120, deadline=None, derandomize=True, database=None)
def test_an_update_on_the_robot_is_refused_in_one_line_or_taken(log, k, argument):
    from pmcl.localization.recent import RecentRows

    rows = RecentRows(log, 3)
    rows.add(0.0, None, {"range": None})
    refused = ""
    try:
        if argument == "time":
            robot = OnlineLocalizer.__new__(OnlineLocalizer)
            robot._rows = rows
            robot._prepared = None
            robot.update(VALUES[k], [0.0, 0.0, 0.0])
        elif argument == "odometry":
            rows.add(1.0, VALUES[k], {"range": None})
        else:
            rows.add(1.0, [0.0, 0.0, 0.0], {"range": None} | {argument: VALUES[k]})
    except PmclError as error:
        refused = str(error)
    except AttributeError:
        assert argument == "time"  # the filter behind the checks was reached
        assert real(0.0, math.inf, open_low=True)(VALUES[k])
    assert "\n" not in refused


def test_files_are_written_only_to_paths(log, tmp_path):
    for value in VALUES:
        if not isinstance(value, str | Path):
            with pytest.raises(PmclError, match="path"):
                log.write(value)


def test_one_effect_without_a_list_is_refused():
    with pytest.raises(PmclError, match="also around one"):
        pmcl.simulate_amigobot(4.0, effects="range-bias")
    with pytest.raises(PmclError, match="pair"):
        pmcl.simulate_amigobot(4.0, effects=[3])
    with pytest.raises(PmclError, match="expected numbers"):
        pmcl.simulate_amigobot(4.0, effects=[(effect_named("range-bias"), "much")])
    with pytest.raises(PmclError, match="also around one"):
        pmcl.RobotModel(sensors=pmcl.default_model(pmcl.simulate_amigobot(4.0)).sensors[0])
