"""Motion noise with heavy tails as Gaussian noise that is wider at some rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.linear import draw_precisions
from pmcl.models.motions.joined.table import JoinedMotion, parts_of_joined
from pmcl.models.tables import Tables

__all__ = ["given_precisions", "inverse_freedom", "motion_between_seams", "with_expected_noise"]

Float = NDArray[np.float64]

# Draws of the precisions of a step that tell their mean to a tenth, with two degrees of freedom.
_DRAWS = 64


def motion_between_seams(tables: Tables) -> Any:
    """Return the table of the motion between the seams of joined logs."""
    return parts_of_joined(tables)[0].motion


def inverse_freedom(tables: Tables) -> float:
    """Return the inverse degrees of freedom of the motion's noise; 0 where it is Gaussian."""
    return float(getattr(getattr(motion_between_seams(tables), "extras", None), "tail", 0.0))


def given_precisions(tables: Tables, log_precision: Float) -> Tables:
    """Return tables whose motion has Gaussian noise, with some precisions of each row.

    Parameters
    ----------
    tables : Tables
        Of motion whose noise is Student's t.
    log_precision : ndarray, shape (T, 3)
        Logs of the precisions of forward, left and turn noise, relative to their scale.
    """
    plain, seams = parts_of_joined(tables)
    motion: Any = plain.motion
    motion = motion._replace(
        std=motion.std * np.exp(-0.5 * log_precision), extras=motion.extras._replace(tail=0.0)
    )
    return tables._replace(motion=motion if seams is None else JoinedMotion(motion, seams))


def with_expected_noise(tables: Tables, path: Float, rng: np.random.Generator) -> Tables:
    """Return tables whose motion has Gaussian noise of the variance that each step of a path leads to expect.

    Parameters
    ----------
    tables : Tables
        Of any motion; returned as they are where its noise is Gaussian.
    path : ndarray, shape (T, D)
        The path.
    rng : numpy.random.Generator
        Source of randomness.

    Notes
    -----
    Given a step, the precision w of noise with v degrees of freedom is gamma distributed with shape (v + 1) / 2, so
    that the expected variance E[1 / w] is (v + 1) / (v - 1) / E[w]. The mean of draws tells E[w] well, while that of
    their inverses hardly converges for two degrees of freedom.
    """
    tail = inverse_freedom(tables)
    if not tail > 0.0:
        return tables
    draws = [draw_precisions(tables, path, rng) for _ in range(_DRAWS)]
    drawn, mean = draws[0][1], np.mean([precision for precision, _ in draws], axis=0)
    mean[drawn] *= (1.0 - tail) / (1.0 + tail)
    # The tables may have more rows than the path.
    further = motion_between_seams(tables).std.shape[0] - len(path)
    return given_precisions(tables, np.pad(np.log(mean), ((0, further), (0, 0))))
