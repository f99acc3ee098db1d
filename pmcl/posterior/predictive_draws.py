"""Groups ``log_likelihood`` and ``posterior_predictive``: predictions of filters with draws of theta.

Both are sequential, since a robot's readings are a time series with a hidden path. The log likelihood of a reading is
conditional on all readings before it; its terms add up to the log evidence of the draw. A replicated row of readings is
drawn from the filter's particles before they were weighted by that row. ``az.loo`` of such terms estimates how well the
next reading is predicted when theta is inferred without one term; it is not leave-one-out over independent readings.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.filtering.one_step_ahead import Predictions, predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables
from pmcl.posterior.log_groups import over_channels, reading_kinds, suffixes_for

__all__ = ["predictive_groups"]

Float = NDArray[np.float64]

# Draws of theta per chain: a hundred in four chains, enough for the Pareto smoothing of az.loo.
_DRAWS_PER_CHAIN = 25
# Long logs get fewer draws, so that each group holds at most so many values (16 MB).
_MOST_VALUES = 2_000_000
# Readings times particles times draws: 1 to 2 s of one core (2.5 GHz Xeon).
_BUDGET = 1e8
_PARTICLES = (100, 1000)


_PREDICTION = {
    "log_likelihood": "one step ahead: log density of each reading given theta and all readings before it, estimated "
    "by a particle filter",
    "posterior_predictive": "one row ahead: readings replicated from the filter's particles before it saw their row",
}


class _Task(NamedTuple):
    """One filter pass over all logs, with a draw of theta."""

    chain: int
    draw: int
    theta: Float


class _Predicted(NamedTuple):
    """Log predictive densities and replicated values of the measured readings of one kind."""

    log_density: Float
    replicated: Float


def predictive_groups(
    bound: BoundModel, theta: Float, observed: xr.Dataset, seed: int
) -> dict[str, xr.Dataset]:
    """Predict all readings with some draws of theta.

    Parameters
    ----------
    bound : BoundModel
        The model bound to L logs.
    theta : ndarray, shape (K, N, d)
        Draws of its parameters.
    observed : xarray.Dataset
        The group ``observed_data``, whose variables and dimensions the result repeats.
    seed : int
        Determines all random numbers.

    Returns
    -------
    dict of str to xarray.Dataset
        ``log_likelihood`` [nat] and ``posterior_predictive`` (units of the readings), each over chain, draw and the
        readings of a kind. Empty when the logs hold no reading that the model predicts.

    Raises
    ------
    FilterError
        When a filter loses the robot entirely.
    ModelError
        When a sensor table cannot be simulated.
    """
    n_chains, n_draws, _ = theta.shape
    n_readings = sum(variable.size for variable in observed.data_vars.values())
    if n_readings == 0:
        return {}
    per_chain = int(np.clip(_MOST_VALUES // (n_readings * n_chains), 1, min(_DRAWS_PER_CHAIN, n_draws)))
    chosen = np.unique(np.linspace(0, n_draws - 1, per_chain).astype(np.int64))
    particles = int(np.clip(_BUDGET / (n_readings * n_chains * chosen.size), *_PARTICLES))
    tasks = [_Task(chain, int(draw), theta[chain, draw]) for chain in range(n_chains) for draw in chosen]

    def predict(task: _Task) -> list[dict[str, _Predicted]]:
        rng = make_rng(np.random.SeedSequence((seed, 1, task.chain, task.draw)))
        return [
            _predicted(log, tables, particles, rng)
            for log, tables in zip(bound.logs, bound.tables(task.theta), strict=True)
        ]

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        predicted = list(threads.map(predict, tasks))
    coords = {"chain": np.arange(n_chains), "draw": chosen}
    groups = {"log_likelihood": xr.Dataset(coords=coords), "posterior_predictive": xr.Dataset(coords=coords)}
    for number, suffix in enumerate(suffixes_for(len(bound.logs))):
        for kind in predicted[0][number]:
            of_kind = [of_logs[number][kind] for of_logs in predicted]
            _add(groups, observed, f"{kind}{suffix}", of_kind, (n_chains, chosen.size))
    for name, prediction in _PREDICTION.items():
        groups[name].attrs = {"prediction": prediction, "particles": particles}
    return groups if groups["log_likelihood"].data_vars else {}


def _add(
    groups: dict[str, xr.Dataset],
    observed: xr.Dataset,
    name: str,
    predicted: Sequence[_Predicted],
    n_draws: tuple[int, int],
) -> None:
    """Add one kind of reading of one log to both groups."""
    readings = observed[name]
    labels = {
        "log_likelihood": ("nat", f"log predictive density of {name}"),
        "posterior_predictive": (str(readings.attrs.get("units", "")), f"replicated {name}"),
    }
    contents = {
        "log_likelihood": [prediction.log_density for prediction in predicted],
        "posterior_predictive": [prediction.replicated for prediction in predicted],
    }
    for group, (units, long_name) in labels.items():
        values = np.array(contents[group], dtype=np.float32)
        groups[group][name] = xr.DataArray(
            values.reshape(*n_draws, readings.size),
            dims=("chain", "draw", *readings.dims),
            coords={key: coord for key, coord in readings.coords.items() if coord.dims == readings.dims},
            attrs={"units": units, "long_name": long_name},
        )


def _predicted(
    log: RobotLog, tables: Tables, particles: int, rng: np.random.Generator
) -> dict[str, _Predicted]:
    """Return, for each kind of reading, log densities and replicated values in the order of the observed data."""
    predictions = predict_readings(tables, log.n_steps, particles, rng)
    replicated = _replicated(log, tables, predictions, rng)
    result = {}
    for number, kind in enumerate(predictions.kinds):
        selected = predictions.kind == number
        if kind not in replicated:
            continue
        measured = ~np.isnan(log.dataset[kind].values)
        score = np.full(measured.shape, np.nan)
        places = predictions.time[selected], predictions.channel[selected]
        over_channels(score)[places] = predictions.log_score[selected]
        # A model need not predict every kind of reading that a log holds.
        if not np.isnan(score[measured]).any():
            result[kind] = _Predicted(score[measured], replicated[kind][measured])
    return result


def _replicated(log: RobotLog, tables: Tables, predictions: Predictions, rng: np.random.Generator) -> dict[str, Float]:
    """Draw each row of readings from a particle not yet weighted by it: kind to an array over time and channel.

    Particles are resampled at every row, so that before its readings they have equal weights. Readings may depend on
    the state one row before as well: rows are simulated in two halves, in each of which every other row follows the
    particle's own ancestor.
    """
    filtered = predictions.filtered
    rows = np.arange(log.n_steps)
    which = rng.integers(filtered.particles.shape[2], size=rows.size)
    now = filtered.particles[rows, :, which]
    before = filtered.particles[rows[:-1], :, filtered.ancestors[rows[1:], which[1:]]]
    kinds = reading_kinds(log.dataset)
    replicated: dict[str, Float] = {}
    for parity in (0, 1):
        path = now.copy()
        later = rows[1:][rows[1:] % 2 == parity]
        path[later - 1] = before[later - 1]
        for sensor in tables.sensors:
            sensor_type = sensor_of(sensor)
            index = sensor_type.index(sensor_type.simulate(sensor, path, rng), rows.size)
            for number, kind in enumerate(index.kinds):
                if kind in kinds:
                    selected = (index.kind == number) & (index.time % 2 == parity)
                    grid = replicated.setdefault(kind, np.full(log.dataset[kind].shape, np.nan))
                    over_channels(grid)[index.time[selected], index.channel[selected]] = index.reading[selected]
    return replicated
