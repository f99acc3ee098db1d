"""Which compiled functions a task will need for some tables, so that a second process can compile them in time."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np

from pmcl.filtering.kernels import linear, smc
from pmcl.filtering.kernels.ahead import Call, compile_ahead
from pmcl.filtering.kernels.contract import state_size
from pmcl.filtering.kernels.geometry import ReadingGeometry, RichGeometry
from pmcl.filtering.kernels.resampling import SCHEMES, AnyScheme
from pmcl.filtering.kernels.rich_ranges import rays_along, terms_given_rays
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.rich_tables import RichLandmarks, RichRangeBeams, rich_beams, rich_landmarks, rich_motion, uniform
from pmcl.models.tables import IncrementMotion, LandmarkSightings, RangeBeams, Tables

__all__ = ["compile_for_calibration", "compile_for_criticism"]


def compile_for_calibration(tables: Tables) -> None:
    """Begin to compile what a calibration with such tables needs; return at once."""
    compile_ahead([*_sampling(tables), *_filtering(tables)[:2]])


def compile_for_criticism(tables: Tables) -> None:
    """Begin to compile what the criticism of a model with such tables needs; return at once."""
    motion = tables.motion
    moved = tables._replace(motion=rich_motion(motion)) if isinstance(motion, IncrementMotion) else tables
    full = uniform(tables._replace(sensors=tuple(_rich(sensor) for sensor in tables.sensors)))
    filtering = _filtering(tables)
    compile_ahead(
        [
            *filtering[:1],
            *_sampling(tables),
            *filtering[1:],
            *_scoring(tables),
            *_scoring(full),
            *_filtering(moved)[:1],
            *_filtering(full)[:1],
            *_sampling(full),
        ]
    )


def _rich(sensor: Any) -> Any:
    if isinstance(sensor, RangeBeams):
        return rich_beams(sensor)
    return rich_landmarks(sensor) if isinstance(sensor, LandmarkSightings) else sensor


@singledispatch
def _geometry(sensor: Any) -> Any:
    """Return a linearisation of the type that :func:`pmcl.filtering.predict.reading_geometry` makes of a table."""
    return None


@_geometry.register(RangeBeams)
@_geometry.register(LandmarkSightings)
def _(sensor: Any) -> ReadingGeometry:
    number, index = np.empty(1), np.empty(1, dtype=np.int64)
    return ReadingGeometry(index, index, index, number, number, np.empty((1, 3)), number)


@_geometry.register(RichRangeBeams)
@_geometry.register(RichLandmarks)
def _(sensor: Any) -> RichGeometry:
    number, index = np.empty(1), np.empty(1, dtype=np.int64)
    return RichGeometry(index, index, index, number, number, np.empty((1, 3)), number, number, number, number)


def _sampling(tables: Tables) -> list[Call]:
    """Return the calls of a particle Gibbs sweep with its transport moves, in their order."""
    rng, path = make_rng(0), np.empty((1, int(state_size(tables.motion))))
    calls: list[Call] = [
        (smc.sweep, (tables, rng, 1, 1, True, path)),
        (smc.joint_terms, (tables, path)),
    ]
    geometries = tuple(_geometry(sensor) for sensor in tables.sensors)
    if None not in [geometry and 1 for geometry in geometries]:
        starts, logs = np.empty(1, dtype=np.int64), np.empty(1)
        calls += [
            (linear.factorise, (tables, geometries, path)),
            (linear.refresh_blocks, (tables, geometries, path, path, starts, path, logs)),
            (linear.transport_trial, (tables, geometries, path, path, path, path, path)),
        ]
    return calls


def _filtering(tables: Tables) -> list[Call]:
    """Return the calls of the particle filter, of one-step-ahead predictions, and of backward sampling."""
    size = int(state_size(tables.motion))
    settings = (tables, make_rng(0), 1, 1, AnyScheme(SCHEMES["multinomial"]), 1.0)
    history = (np.empty((1, size, 1)), np.empty((1, 1)), np.empty((1, 1), dtype=np.uint32))
    return [
        (smc.filter_pass, settings),
        (smc.predictive_pass, settings),
        (smc.sample_backward, (tables, make_rng(0), *history, 1)),
    ]


def _scoring(tables: Tables) -> list[Call]:
    """Return the calls that score candidate effects along trajectories."""
    columns = np.empty((1, int(state_size(tables.motion)), 1))
    calls: list[Call] = [(smc.motion_terms, (tables.start, tables.motion, columns))]
    for sensor in tables.sensors:
        if isinstance(sensor, RichRangeBeams):
            calls.append((rays_along, (sensor, columns)))
            calls.append((terms_given_rays, (sensor, columns, columns, np.empty(1, dtype=np.int64))))
        calls.append((smc.sensor_terms, (sensor, columns)))
    return calls
