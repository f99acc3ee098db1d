"""What the posterior keeps of the logs it was inferred from: readings, map, start belief and truth.

One log keeps the names of its file. Several logs share one theta but not their times, beams or maps, so their
variables and dimensions are numbered: ``odometry_0(time_0, increment)``, ``odometry_1(time_1, increment)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import xarray as xr

__all__ = ["LogLike", "agreed_truth", "log_groups", "suffixes_for"]

# Dimensions that mean the same in every log.
_SHARED_DIMS = frozenset({"increment", "pose", "xy", "end"})


class LogLike(Protocol):
    """What the conversion needs to know of a robot log (:class:`pmcl.logs.robot_log.RobotLog` has it)."""

    @property
    def dataset(self) -> xr.Dataset:
        """The log with the variables of its file format."""

    @property
    def true_theta(self) -> Mapping[str, float] | None:
        """Parameters that a simulated log was made with."""

    def fingerprint(self) -> str:
        """Hash over everything that calibration sees."""


def suffixes_for(n_logs: int) -> tuple[str, ...]:
    """Give the endings of the variables of each log.

    Parameters
    ----------
    n_logs : int

    Returns
    -------
    tuple of str, length n_logs
        ``("",)`` for one log, ``("_0", "_1", ...)`` for several.
    """
    return ("",) if n_logs == 1 else tuple(f"_{index}" for index in range(n_logs))


def log_groups(logs: Sequence[LogLike]) -> tuple[xr.Dataset, xr.Dataset]:
    """Observed and constant data of the logs.

    Parameters
    ----------
    logs : sequence of logs

    Returns
    -------
    observed : xarray.Dataset
        Everything measured: odometry and sensor readings over time.
    constant : xarray.Dataset
        Everything given: map, beam poses, start belief, the scalars ``true_<name>`` that the logs agree on, and the
        reference trajectory ``true_pose``, which serves scoring and pictures only.
    """
    observed: list[xr.Dataset] = []
    constant: list[xr.Dataset] = []
    for log, suffix in zip(logs, suffixes_for(len(logs)), strict=True):
        dataset = log.dataset.drop_encoding()
        measured = [name for name, values in dataset.data_vars.items() if "time" in values.dims and name != "true_pose"]
        given = [name for name in dataset.data_vars if name not in measured]
        # The truth is a JSON text among the attributes of the log; it is kept as numbers below instead.
        attrs = {f"{key}{suffix}": value for key, value in dataset.attrs.items() if key in ("robot", "source", "seed")}
        observed.append(_numbered(dataset[measured], suffix).assign_attrs(attrs))
        constant.append(_numbered(dataset[given], suffix))
    truth = {f"true_{name}": np.float64(value) for name, value in agreed_truth(logs).items()}
    return _merged(observed), _merged(constant).assign(truth)


def agreed_truth(logs: Sequence[LogLike]) -> dict[str, float]:
    """Give the true parameters of simulated logs.

    Parameters
    ----------
    logs : sequence of logs

    Returns
    -------
    dict of str to float
        A parameter on which two logs differ is left out: the one theta they share then has no true value.
    """
    known: dict[str, set[float]] = {}
    for log in logs:
        for name, value in (log.true_theta or {}).items():
            known.setdefault(name, set()).add(float(value))
    return {name: values.pop() for name, values in known.items() if len(values) == 1}


def _numbered(dataset: xr.Dataset, suffix: str) -> xr.Dataset:
    names = {str(name) for name in (*dataset.variables, *dataset.dims)} - _SHARED_DIMS if suffix else set()
    renamed = dataset.rename({name: f"{name}{suffix}" for name in names})
    renamed.attrs = {}
    return renamed


def _merged(datasets: Sequence[xr.Dataset]) -> xr.Dataset:
    # Names cannot clash after numbering, and the shared dimensions have one meaning: nothing to align.
    return xr.merge(datasets, join="exact", combine_attrs="no_conflicts", compat="equals")
