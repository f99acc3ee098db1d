"""Comparing Monte Carlo estimates with exact numbers: 5 standard errors, and sharp enough to see what matters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

TOLERANCE, SHARPNESS = 5.0, 8.0


def standard_error(draws: Float) -> Float:
    """Standard error of the mean of draws along axis 0; independent draws."""
    return np.std(draws, axis=0, ddof=1) / np.sqrt(len(draws))


def chain_standard_error(draws: Float, batches: int = 20) -> Float:
    """Standard error of the mean over chains and draws (K, N, ...), from the means of long batches of each chain."""
    length = draws.shape[1] // batches
    means = draws[:, : length * batches].reshape(draws.shape[0] * batches, length, *draws.shape[2:]).mean(axis=1)
    return np.std(means, axis=0, ddof=1) / np.sqrt(len(means))


def off_by(draws: Float, exact: Float | float) -> Float:
    """By how many standard errors the mean of independent draws (axis 0) is off."""
    return np.abs(np.mean(draws, axis=0) - exact) / standard_error(draws)


def assert_agrees(draws: Float, exact: Float | float, matters: Float | float) -> None:
    """Assert that independent draws agree with an exact mean, and that a bias of `matters` could not hide."""
    sharpness = np.min(np.asarray(matters) / standard_error(draws))
    assert sharpness >= SHARPNESS, f"too few draws: a bias that matters is only {sharpness:.1f} standard errors"
    off = off_by(draws, exact)
    assert np.all(off <= TOLERANCE), f"off by up to {np.max(off):.1f} standard errors"
