"""Densities of whole paths, and each row's share of them (eq. 16 without the prior)."""

from __future__ import annotations

import numpy as np

from pmcl.engine.compile import entry, kernel
from pmcl.engine.contract import path_reading_logpdf, path_transition_logpdf, scratch_rows, start_logpdf
from pmcl.engine.sensor_tuples import sum_path_logpdf
from pmcl.engine.vector_math import total
from pmcl.filtering.kernels.forward import work_rows

__all__ = ["joint_logpdf", "joint_terms", "motion_terms", "sensor_terms"]


@kernel
def joint_logpdf(tables, columns, logp, scratch):
    """Return log p(path, readings | theta) of a path as `columns` (D, T); `logp` (T,) receives each row's share."""
    n_steps, size = columns.shape[1], columns.shape[0]
    for t in range(n_steps):
        logp[t] = 0.0
    first = scratch[0, :size]
    for d in range(size):
        first[d] = columns[d, 0]
    start_logpdf(tables.start, first.reshape(size, 1), logp[:1])
    path_transition_logpdf(tables.motion, n_steps, columns, logp, scratch)
    sum_path_logpdf(tables.sensors, n_steps, columns, logp, scratch)
    return total(logp)


@entry
def joint_terms(tables, path):
    """Return log p(path, readings | theta) of `path` (T, D), eq. 16 without the prior, and each row's share (T,)."""
    n_steps, size = path.shape
    columns, logp = np.empty((size, n_steps)), np.empty(n_steps)
    for t in range(n_steps):
        for d in range(size):
            columns[d, t] = path[t, d]
    value = joint_logpdf(tables, columns, logp, np.empty((work_rows(tables), max(n_steps, size))))
    return value, logp


@entry
def motion_terms(start, motion, columns):
    """Return the log densities of start and transitions of trajectories `columns` (M, D, T), as (M, T)."""
    n_paths, size, n_steps = columns.shape
    logp = np.zeros((n_paths, n_steps))
    rows = max(scratch_rows(motion), scratch_rows(start)) + 3
    scratch = np.empty((rows, max(n_steps, size)))
    for k in range(n_paths):
        first = scratch[0, :size]
        for d in range(size):
            first[d] = columns[k, d, 0]
        start_logpdf(start, first.reshape(size, 1), logp[k, :1])
        path_transition_logpdf(motion, n_steps, columns[k], logp[k], scratch)
    return logp


@entry
def sensor_terms(sensor, columns):
    """Return the log densities of one sensor's readings along trajectories `columns` (M, D, T), as (M, T)."""
    n_paths, size, n_steps = columns.shape
    logp = np.zeros((n_paths, n_steps))
    scratch = np.empty((scratch_rows(sensor) + 3, max(n_steps, size)))
    for k in range(n_paths):
        path_reading_logpdf(sensor, n_steps, columns[k], logp[k], scratch)
    return logp
