"""From the plain arrays of a calibration run to labelled ArviZ groups.

``arviz.from_emcee`` has no place for trajectories, several logs or statistics per parameter, hence this converter.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import PosteriorError
from pmcl.geometry import wrap
from pmcl.posterior.compat import Posterior, assemble
from pmcl.posterior.log_groups import LogLike, log_groups, suffixes_for
from pmcl.posterior.settings import encode_setting
from pmcl.sampling.chains import Chains, PointEstimate

__all__ = ["ParameterLike", "to_arviz"]

Float = NDArray[np.float64]

# Points at which the density of each prior is kept, so that a report can draw it without the model.
_PRIOR_POINTS = 201
_POSE = ["x", "y", "heading"]
# Units and meaning of the statistics of methods; those of other names have no unit.
_STATISTICS = {
    "acceptance_rate": ("1", "share of accepted Metropolis proposals"),
    "transport_walk_acceptance_rate": ("1", "share of accepted random walks of theta that carry the path along"),
    "transport_jump_rate": ("1", "share of accepted independent proposals of theta that carry the path along"),
    "path_block_redraw_rate": ("1", "share of blocks of the path that were redrawn"),
    "path_update_rate": ("1", "share of rows of the path that a sweep changes"),
    "particle_ess": ("1", "effective particles, mean over rows"),
    "standard_error": ("of the parameter", "standard error of a point estimate"),
    "log_evidence": ("nat", "particle filter's estimate of the log evidence"),
}


class ParameterLike(Protocol):
    """A parameter, as the conversion needs it."""

    @property
    def name(self) -> str:
        """Name, unique in the model."""

    @property
    def unit(self) -> str:
        """SI unit, ``"1"`` for ratios."""

    @property
    def prior(self) -> Any:
        """Frozen distribution of :mod:`scipy.stats`."""

    @property
    def description(self) -> str:
        """What the parameter means, in one line."""


def to_arviz(
    result: Chains | PointEstimate,
    parameters: Sequence[ParameterLike],
    logs: Sequence[LogLike],
    *,
    prior_draws: int = 1000,
    prior_seed: int = 0,
) -> Posterior:
    """Label the result of a calibration.

    Parameters
    ----------
    result : Chains or PointEstimate
        K chains of N draws of d parameters, with trajectories of each log or without. A point estimate becomes one
        chain of one draw, whose standard errors are in ``sample_stats``.
    parameters : sequence of parameters, length d
        In the order of ``result.names``.
    logs : sequence of logs
        In the order of ``result.trajectories``.
    prior_draws : int
        How many draws from the prior to keep beside the posterior.
    prior_seed : int
        Seed of these draws. They take no part in the inference.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        Groups ``posterior``, ``sample_stats``, ``prior``, ``observed_data``, ``constant_data``, when trajectories were
        kept ``trajectories``, and when burn-in was kept ``warmup_posterior`` and ``warmup_sample_stats``. Settings and
        the hash of each log are attributes.

    Raises
    ------
    PosteriorError
        If chains, parameters and logs do not belong together, or a draw is not a number.

    Notes
    -----
    The group ``posterior`` holds the parameters and nothing else, so that ``arviz.summary(data)`` and
    ``arviz.plot_trace(data)`` need no further arguments. Trajectories are thinned, so ``trajectory`` runs over
    ``trajectory_draw`` instead of ``draw`` and has a group of its own.
    """
    chains = result.as_chains() if isinstance(result, PointEstimate) else result
    _check_chains(chains, parameters)
    _check_trajectories(chains, logs)
    observed, constant = log_groups(logs)
    for parameter in parameters:
        if f"true_{parameter.name}" in constant:
            constant[f"true_{parameter.name}"].attrs = {**_labels(parameter), "long_name": f"true {parameter.name}"}
    attrs = _attributes(chains, logs)
    groups = {
        "posterior": _theta(chains.theta, parameters).assign_attrs(attrs),
        "sample_stats": _statistics(chains),
        "prior": _prior(parameters, prior_draws, prior_seed),
        "observed_data": observed,
        "constant_data": xr.merge([constant, _prior_density(chains.theta, parameters)]),
    }
    trajectories = _trajectories(chains, logs)
    if trajectories.data_vars:
        groups["trajectories"] = trajectories
    if chains.warmup_theta is not None and chains.warmup_theta.shape[1] > 0:
        groups["warmup_posterior"] = _theta(chains.warmup_theta, parameters)
        if chains.warmup_log_joint is not None:
            groups["warmup_sample_stats"] = _log_joint(chains.warmup_log_joint)
    return assemble(groups, attrs)


def _theta(theta: Float, parameters: Sequence[ParameterLike]) -> xr.Dataset:
    variables = {
        parameter.name: xr.DataArray(
            theta[..., index], dims=("chain", "draw"), attrs={**_labels(parameter), "prior": _describe(parameter.prior)}
        )
        for index, parameter in enumerate(parameters)
    }
    return xr.Dataset(variables, coords=_sample_coords(theta.shape[0], theta.shape[1]))


def _trajectories(chains: Chains, logs: Sequence[LogLike]) -> xr.Dataset:
    variables: dict[str, xr.DataArray] = {}
    coords: dict[str, Any] = {}
    # A method may draw no trajectories.
    for states, log, suffix in zip(chains.trajectories, logs, suffixes_for(len(logs)), strict=False):
        # A dimension of length zero would turn into an unlimited one on disk.
        if states.shape[1] == 0:
            continue
        dims = ("chain", "trajectory_draw", f"time{suffix}")
        poses = np.array(states[..., :3])
        poses[..., 2] = wrap(poses[..., 2])
        variables[f"trajectory{suffix}"] = xr.DataArray(
            poses,
            dims=(*dims, "pose"),
            attrs={"units": "m, m, rad", "long_name": "sampled poses (x, y, heading)"},
        )
        if states.shape[-1] > 3:
            variables[f"extra_state{suffix}"] = xr.DataArray(
                states[..., 3:],
                dims=(*dims, "extra"),
                attrs={"units": "of the state", "long_name": "states beyond the pose, such as a drifting gyro bias"},
            )
        times = np.asarray(log.dataset["time"].values)
        coords[f"time{suffix}"] = ((f"time{suffix}",), times, {"units": "s", "long_name": "time"})
        coords |= {"trajectory_draw": chains.trajectory_draw, "pose": _POSE, "chain": np.arange(chains.n_chains)}
    return xr.Dataset(variables, coords=coords)


def _statistics(chains: Chains) -> xr.Dataset:
    draws = _sample_coords(chains.n_chains, chains.n_draws)
    dataset = xr.Dataset(coords=draws) if chains.log_joint is None else _log_joint(chains.log_joint)
    for name, values in chains.statistics.items():
        dims = ("chain", "draw") if values.ndim == 2 else ("chain", "draw", "parameter")
        units, long_name = _STATISTICS.get(name, ("1", name.replace("_", " ")))
        dataset[name] = xr.DataArray(values, dims=dims, attrs={"units": units, "long_name": long_name})
    if "parameter" in dataset.dims:
        dataset = dataset.assign_coords(parameter=list(chains.names))
    return dataset


def _log_joint(values: Float) -> xr.Dataset:
    long_name = "log joint density of parameters, trajectories and readings"
    lp = xr.DataArray(values, dims=("chain", "draw"), attrs={"units": "nat", "long_name": long_name})
    return xr.Dataset({"lp": lp}, coords=_sample_coords(*values.shape))


def _sample_coords(n_chains: int, n_draws: int) -> dict[str, NDArray[np.int64]]:
    return {"chain": np.arange(n_chains), "draw": np.arange(n_draws)}


def _prior(parameters: Sequence[ParameterLike], n_draws: int, seed: int) -> xr.Dataset:
    generator = np.random.default_rng(seed)
    variables = {
        parameter.name: xr.DataArray(
            np.asarray(parameter.prior.rvs(size=(1, n_draws), random_state=generator), dtype=np.float64),
            dims=("chain", "draw"),
            attrs=_labels(parameter),
        )
        for parameter in parameters
    }
    return xr.Dataset(variables, coords=_sample_coords(1, n_draws))


def _prior_density(theta: Float, parameters: Sequence[ParameterLike]) -> xr.Dataset:
    """Prior densities where the posterior is, since a thousand prior draws say little about so small a place."""
    low, high = theta.min(axis=(0, 1)), theta.max(axis=(0, 1))
    margin = 0.25 * np.where(high > low, high - low, np.maximum(np.abs(low), 1e-3))
    grid = np.linspace(low - margin, high + margin, _PRIOR_POINTS, axis=1)
    density = np.array([parameter.prior.pdf(points) for parameter, points in zip(parameters, grid, strict=True)])
    # A density may have a pole at the edge of its support; no picture can show it.
    density = np.where(np.isfinite(density), density, np.nan)
    dims = ("parameter", "prior_point")
    return xr.Dataset(
        {
            "prior_grid": (dims, grid, {"units": "of the parameter", "long_name": "values of the parameter"}),
            "prior_density": (dims, density, {"units": "1 / unit of the parameter", "long_name": "prior density"}),
        },
        coords={"parameter": [parameter.name for parameter in parameters]},
    )


def _labels(parameter: ParameterLike) -> dict[str, str]:
    return {"units": parameter.unit, "long_name": parameter.description}


def _describe(prior: Any) -> str:
    family = getattr(getattr(prior, "dist", None), "name", type(prior).__name__)
    arguments = [f"{value:g}" for value in getattr(prior, "args", ())]
    arguments += [f"{key}={value:g}" for key, value in getattr(prior, "kwds", {}).items()]
    return f"{family}({', '.join(arguments)})"


def _attributes(chains: Chains, logs: Sequence[LogLike]) -> dict[str, str | int | float]:
    attrs: dict[str, Any] = {
        "format": "pmcl-posterior/1",
        "inference_library": "pmcl",
        "inference_library_version": importlib.metadata.version("pmcl"),
    }
    attrs |= {
        f"log_fingerprint{suffix}": log.fingerprint() for log, suffix in zip(logs, suffixes_for(len(logs)), strict=True)
    }
    attrs |= dict(chains.settings)
    return {name: encode_setting(name, value) for name, value in attrs.items()}


def _check_chains(chains: Chains, parameters: Sequence[ParameterLike]) -> None:
    names = tuple(parameter.name for parameter in parameters)
    if names != chains.names:
        raise PosteriorError(
            f"expected the parameters of the chains, {', '.join(chains.names)}, in this order, got "
            f"{', '.join(names) or 'none'}: pass the parameters of the model that was calibrated"
        )
    if chains.theta.ndim != 3 or chains.theta.shape[2] != len(names) or 0 in chains.theta.shape:
        raise PosteriorError(
            f"expected draws of shape (chains, draws, {len(names)}) with at least one of each, got "
            f"{chains.theta.shape}: run the calibration with more draws"
        )
    bad = np.argwhere(~np.isfinite(chains.theta))
    if bad.size:
        chain, draw, index = bad[0]
        raise PosteriorError(
            f"expected finite draws, got {chains.theta[chain, draw, index]} for {names[index]} in chain {chain} at "
            f"draw {draw}: check the prior and the model for this parameter"
        )
    draws = chains.theta.shape[:2]
    joint = [] if chains.log_joint is None else [("lp", chains.log_joint)]
    for name, values in (*joint, *chains.statistics.items()):
        fits = values.shape == draws or (name != "lp" and values.shape == chains.theta.shape)
        if not fits or (name == "lp" and values is not chains.log_joint):
            raise PosteriorError(
                f"expected the statistic {name!r} with shape {draws} or {chains.theta.shape}, and 'lp' only once, got "
                f"{values.shape}: store one value per draw, or one per draw and parameter"
            )


def _check_trajectories(chains: Chains, logs: Sequence[LogLike]) -> None:
    if len(logs) == 0 or (chains.trajectories and len(chains.trajectories) != len(logs)):
        raise PosteriorError(
            f"expected one array of trajectories for each log, got {len(chains.trajectories)} for {len(logs)} logs: "
            "pass the logs that were calibrated, in the same order"
        )
    for index, (states, log) in enumerate(zip(chains.trajectories, logs, strict=False)):
        expected = (chains.n_chains, len(chains.trajectory_draw), log.dataset.sizes["time"])
        if states.ndim != 4 or states.shape[:3] != expected or states.shape[3] < 3:
            raise PosteriorError(
                f"expected trajectories of shape {expected} + (3 or more,) for log {index}, got {states.shape}: "
                "pass the logs that were calibrated, in the same order"
            )
