"""Exact answers for a linear-Gaussian scalar model: recursions, and the same again with dense matrices.

x[0] ~ N(mean, std^2), x[t] = a x[t-1] + control[t] + q normal, z[t] = x[t] + r normal; z is NaN where nothing was
measured.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.models.tables import Tables

Float = NDArray[np.float64]


class LinearModel(NamedTuple):
    """Known coefficients; the noises q and r are given to each function, as numbers or as arrays of one shape."""

    a: float
    control: Float
    mean: float
    std: float
    reading: Float


def linear_model(tables: Tables) -> LinearModel:
    """Take the coefficients out of tables of the rail model."""
    start, motion, sensor = tables.start, tables.motion, tables.sensors[0]
    return LinearModel(motion.coefficient, motion.control, float(start.mean[0]), float(start.std[0]), sensor.reading)


def log_evidence(model: LinearModel, q, r):
    """log p(z) by the Kalman filter; q and r may be arrays (a whole grid at once)."""
    mean, variance = model.mean + 0.0 * q, model.std**2 + 0.0 * q
    value = 0.0 * q
    for t, z in enumerate(model.reading):
        if t > 0:
            mean, variance = model.a * mean + model.control[t], model.a**2 * variance + q**2
        if not np.isnan(z):
            spread = variance + r**2
            value = value - 0.5 * ((z - mean) ** 2 / spread + np.log(2.0 * np.pi * spread))
            gain = variance / spread
            mean, variance = mean + gain * (z - mean), (1.0 - gain) * variance
    return value


class Filtered(NamedTuple):
    """What is known at each time from the readings up to it: mean, variance (T,), and log density of each reading."""

    mean: Float
    variance: Float
    log_score: Float


def filtered(model: LinearModel, q: float, r: float) -> Filtered:
    """The Kalman filter; the log score is 0 where nothing was measured."""
    out = np.zeros((3, model.reading.size))
    mean, variance = model.mean, model.std**2
    for t, z in enumerate(model.reading):
        if t > 0:
            mean, variance = model.a * mean + model.control[t], model.a**2 * variance + q**2
        if not np.isnan(z):
            spread = variance + r**2
            out[2, t] = -0.5 * ((z - mean) ** 2 / spread + np.log(2.0 * np.pi * spread))
            gain = variance / spread
            mean, variance = mean + gain * (z - mean), (1.0 - gain) * variance
        out[:2, t] = mean, variance
    return Filtered(*out)


def smoother(model: LinearModel, q: float, r: float) -> tuple[Float, Float]:
    """Mean and variance (T,) of x[t] given all readings, by the smoother of Rauch, Tung and Striebel."""
    n = model.reading.size
    predicted, filtered = np.empty((n, 2)), np.empty((n, 2))
    for t, z in enumerate(model.reading):
        mean, variance = (model.mean, model.std**2) if t == 0 else filtered[t - 1]
        if t > 0:
            mean, variance = model.a * mean + model.control[t], model.a**2 * variance + q**2
        predicted[t] = mean, variance
        gain = 0.0 if np.isnan(z) else variance / (variance + r**2)
        filtered[t] = mean + (gain * (z - mean) if gain else 0.0), (1.0 - gain) * variance
    out = filtered.copy()
    for t in range(n - 2, -1, -1):
        g = filtered[t, 1] * model.a / predicted[t + 1, 1]
        out[t, 0] += g * (out[t + 1, 0] - predicted[t + 1, 0])
        out[t, 1] += g**2 * (out[t + 1, 1] - predicted[t + 1, 1])
    return out[:, 0], out[:, 1]


def path_posterior(model: LinearModel, q: float, r: float) -> tuple[Float, Float]:
    """Mean (T,) and covariance (T, T) of the whole path given the readings, from the dense joint precision."""
    n = model.reading.size
    difference = np.eye(n) - model.a * np.eye(n, k=-1)
    noise = np.r_[model.std, np.full(n - 1, q)] ** -2.0
    precision = difference.T @ (noise[:, None] * difference)
    target = np.r_[model.mean, model.control[1:]]
    shift = difference.T @ (noise * target)
    seen = ~np.isnan(model.reading)
    precision[seen, seen] += r**-2.0
    shift[seen] += model.reading[seen] * r**-2.0
    covariance = np.linalg.inv(precision)
    return covariance @ shift, covariance


class Grid(NamedTuple):
    """Moments of a two-dimensional posterior by quadrature."""

    mean: Float
    std: Float
    correlation: float


def grid_posterior(model: LinearModel, log_prior, size: int = 300, top: tuple[float, float] = (2.0, 2.0)) -> Grid:
    """Posterior of (q, r), by the midpoint rule on [0, top]; `log_prior` takes both arrays."""
    step = np.array(top) / size
    q, r = np.meshgrid((np.arange(size) + 0.5) * step[0], (np.arange(size) + 0.5) * step[1], indexing="ij")
    log_density = log_evidence(model, q, r) + log_prior(q, r)
    weight = np.exp(log_density - log_density.max())
    weight /= weight.sum()
    edge = max(weight[-1].sum(), weight[:, -1].sum())
    assert edge < 1e-6, f"the grid cuts the posterior off: {edge:.1e} of it lies at its edge"
    mean = np.array([(weight * q).sum(), (weight * r).sum()])
    deviation = np.stack([q - mean[0], r - mean[1]])
    covariance = np.einsum("ij,aij,bij->ab", weight, deviation, deviation)
    std = np.sqrt(np.diag(covariance))
    return Grid(mean, std, float(covariance[0, 1] / std.prod()))
