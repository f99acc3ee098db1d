"""Which compiled functions a task will need for some tables, so that a second process can compile them in time."""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile_ahead import Call, compile_ahead
from pmcl.engine.contract import state_size
from pmcl.engine.tables import with_extras
from pmcl.filtering.kernels import linear, smc
from pmcl.filtering.kernels.guided import Cloud, Guide, History, guide_of, guided_rows
from pmcl.filtering.kernels.resampling import SCHEMES, AnyScheme
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.motions.joined.table import joined_tables, parts_of_joined
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables, uniform

__all__ = ["compile_for_calibration", "compile_for_criticism"]


def compile_for_calibration(tables: Tables) -> None:
    """Begin to compile what a calibration with such tables needs; return at once.

    Parameters
    ----------
    tables : Tables
        Tables of any theta: only their types count.
    """
    compile_ahead([*_sampling(tables), *_filtering(tables)[:2]])


def compile_for_criticism(tables: Tables) -> None:
    """Begin to compile what the criticism of a model with such tables needs; return at once.

    Parameters
    ----------
    tables : Tables
        Tables of any theta: only their types count. Those with extras, which candidates of effects need, follow them.
    """
    own, seams = parts_of_joined(tables)
    moved = own._replace(motion=with_extras(own.motion))
    full = uniform(own._replace(sensors=tuple(with_extras(sensor) for sensor in own.sensors)))
    if seams is not None:
        moved, full = joined_tables(moved, seams), joined_tables(full, seams)
    filtering = _filtering(tables)
    compile_ahead(
        [
            *filtering[:1],
            *_sampling(tables),
            *filtering[1:],
            *_scoring(tables),
            *_scoring(full),
            *_guided(tables),
            *_guided(moved),
            *_guided(full),
            *_sampling(full),
        ]
    )


def _sampling(tables: Tables) -> list[Call]:
    """Return the calls of a particle Gibbs sweep with its transport moves, in their order."""
    rng, path = make_rng(0), np.empty((1, int(state_size(tables.motion))))
    calls: list[Call] = [
        (smc.redraw_path, (tables, rng, 1, 1, True, path)),
        (smc.joint_terms, (tables, path)),
    ]
    linear_readings = tuple(sensor_of(sensor).linearisation_like(sensor) for sensor in tables.sensors)
    if all(linear is not None for linear in linear_readings):
        starts, logs = np.empty(1, dtype=np.int64), np.empty(1)
        calls += [
            (linear.standardised, (tables, linear_readings, path, path)),
            (linear.refresh_blocks, (tables, linear_readings, path, path, starts, path, logs)),
            (linear.transport_trial, (tables, linear_readings, path, path)),
        ]
    return calls


def _filtering(tables: Tables) -> list[Call]:
    """Return the calls of the particle filter, of one-step-ahead predictions, and of backward sampling."""
    size = int(state_size(tables.motion))
    settings = (tables, make_rng(0), 1, 1, AnyScheme(SCHEMES["multinomial"]), 1.0)
    history = (np.empty((1, size, 1)), np.empty((1, 1)), np.empty((1, 1), dtype=np.uint32))
    return [
        (smc.filter_pass, settings),
        (smc.predictive_pass, (*settings, False, 1)),
        (smc.conditional_pass, (tables, make_rng(0), np.empty((1, size)), 1)),
        (smc.sample_backward, (tables, make_rng(0), *history, 1)),
    ]


def _guided(tables: Tables) -> list[Call]:
    """Return the calls of the filter that a path guides; none where a sensor has no linearisation of its own."""
    linear_readings = tuple(sensor_of(sensor).linearisation_like(sensor) for sensor in tables.sensors)
    if any(linear is None for linear in linear_readings):
        return []
    size = int(state_size(tables.motion))
    path, square = np.empty((1, size)), np.empty((1, size * size))
    guide = Guide(path, square, square, path, square, path)
    settings = (np.ones(1, dtype=np.int64), 0.1, 1.0, 0, 1, False)
    cloud = Cloud(np.empty(size), np.empty(1), np.empty(1), np.zeros(1, dtype=np.int64), np.zeros(1))
    places = np.zeros(0, dtype=np.int64)
    history = History(np.empty(0), np.zeros(0, dtype=np.uint32), places, places)
    return [
        (guide_of, (tables, linear_readings, path, False)),
        (guided_rows, (tables, guide, *settings, make_rng(0), cloud, history, np.zeros((1, 2)))),
    ]


def _scoring(tables: Tables) -> list[Call]:
    """Return the calls that score candidate effects along trajectories."""
    columns = np.empty((1, int(state_size(tables.motion)), 1))
    calls: list[Call] = [(smc.motion_terms, (tables.start, tables.motion, columns))]
    for sensor in tables.sensors:
        calls += sensor_of(sensor).scoring_calls(sensor, columns)
        calls.append((smc.sensor_terms, (sensor, columns)))
    return calls
