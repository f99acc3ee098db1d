"""Errors for densities that are not a number, with the log, the time and the parameters at which they occur.

Such a density is never taken for an impossible one: a mistake in a table would then pass for a model that fits badly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import DensityError
from pmcl.filtering.kernels import smc
from pmcl.models.robot_model import BoundModel

__all__ = ["check_density", "parameters_told", "values_of"]

Float = NDArray[np.float64]


def values_of(bound: BoundModel, theta: Float) -> str:
    """Return parameters as text, e.g. "sigma_range=0.05, sigma_turn=0.1"."""
    return ", ".join(f"{name}={value:.6g}" for name, value in zip(bound.names, theta, strict=True))


def check_density(value: float, bound: BoundModel, theta: Float, paths: Sequence[Float]) -> float:
    """Return a log density unless it is not a number.

    Parameters
    ----------
    value : float
        The log density of some trajectories and all readings, minus infinity where they are impossible.
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        The parameters.
    paths : sequence of ndarray, shape (l, D)
        The trajectories; the rows are evaluated one by one along them to find the time.

    Raises
    ------
    DensityError
        When it is not a number.
    """
    if not math.isnan(value):
        return value
    where, row = "the logs", None
    for log, tables, path in zip(bound.logs, bound.tables(theta), paths, strict=True):
        bad = np.flatnonzero(np.isnan(smc.joint_terms(tables, path)[1]))
        if bad.size:
            row = int(bad[0])
            where = f"{log.where}: at t={log.times[row]:g} s (row {row})"
            break
    raise DensityError(
        f"{where} a density is not a number with {values_of(bound, theta)}; check the coefficient tables of the model "
        "and of its effects",
        row=row,
    )


@contextmanager
def parameters_told(bound: BoundModel, theta: Float, near: bool = False) -> Iterator[None]:
    """Add parameters, and the time where there is one log, to the message of a density that is not a number.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        The parameters.
    near : bool
        Whether the density was met at parameters near these.

    Raises
    ------
    DensityError
        When one is raised inside.
    """
    try:
        yield
    except DensityError as error:
        if "=" in str(error):  # told already, where more was known
            raise
        time = ""
        if error.row is not None and len(bound.logs) == 1:
            time = f"t={bound.logs[0].times[error.row]:g} s, "
        preposition = "near" if near else "at"
        raise DensityError(
            f"{error} ({time}parameters {preposition} {values_of(bound, theta)})", row=error.row
        ) from None
