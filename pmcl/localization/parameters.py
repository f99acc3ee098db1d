"""Which theta a filter works with: one value, or draws of the posterior."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pmcl import defaults
from pmcl.checks import check_choice, check_number, check_type
from pmcl.errors import ModelError, PosteriorError, did_you_mean
from pmcl.localization.options import FilterOptions
from pmcl.models.parameters import ROLES, Parameter, prior_support
from pmcl.models.robot_model import BoundModel
from pmcl.posterior.access import parameter_names, theta_draws
from pmcl.posterior.compat import Posterior
from pmcl.posterior.estimates import map_estimate, posterior_mean

__all__ = ["METHODS", "choose_theta", "default_draws"]

Float = NDArray[np.float64]

METHODS = ("mean", "map", "posterior", "prior")
"""Ways to choose theta; a given theta replaces what they give."""

_DRAWS, _DRAWS_PER_READING = defaults.LOCALIZATION_DRAWS, defaults.LOCALIZATION_DRAWS_PER_READING


def choose_theta(
    bound: BoundModel,
    posterior: Posterior | None,
    method: str,
    theta: Mapping[str, float] | None,
    options: FilterOptions,
) -> tuple[Float, int]:
    """Return the values of theta that a filter works with.

    Parameters
    ----------
    bound : BoundModel
        The model bound to the log.
    posterior : arviz.InferenceData or xarray.DataTree, optional
        Needed by all methods but ``prior``, unless `theta` gives every parameter.
    method : {"mean", "map", "posterior", "prior"}
        Posterior mean (eq. 18), draw of the greatest joint density (eq. 19), the whole posterior (eqs. 21 and 24), or
        the mean of the prior.
    theta : mapping of str to float, optional
        Values that replace those of the method.
    options : FilterOptions
        Numbers of draws.

    Returns
    -------
    theta : ndarray, shape (K, d)
        In the order of the model's parameters; K = 1 except for ``posterior``.
    picks : int
        Draws per reading.

    Raises
    ------
    ModelError
        When `theta` names no parameter of the model, is outside its range, or leaves parameters open.
    PosteriorError
        When there is no posterior, its parameters are not the model's, or it has fewer draws than asked for.
    """
    check_choice("method", method, METHODS, error=PosteriorError)
    if posterior is not None:
        parameter_names(posterior)
    given = _checked(bound, {} if theta is None else theta)
    open_names = [name for name in bound.names if name not in given]
    if not open_names:
        values, picks = np.array([[given[name] for name in bound.names]]).reshape(1, bound.dimension), 1
    elif method == "prior":
        values, picks = bound.prior_mean()[None, :], 1
    elif posterior is None:
        raise PosteriorError(
            f"method '{method}' expects a posterior for {', '.join(open_names)}, but got none; give a posterior, "
            "or a value of every parameter, or use method 'prior'"
        )
    else:
        _check_names(bound, posterior)
        values, picks = _from_posterior(bound.names, posterior, method, options)
        _require_possible(bound, values)
    for k, name in enumerate(bound.names):
        if name in given:
            values[:, k] = given[name]
    bound.check(values[0])
    return values, picks


def default_draws(options: FilterOptions, available: int) -> tuple[int, int]:
    """Return how many draws to work with, and over how many each reading is averaged.

    Parameters
    ----------
    options : FilterOptions
        What was asked for; None there means the default.
    available : int
        Number of draws in the posterior.

    Returns
    -------
    draws, draws_per_reading : int
        Both at most `available`.

    Raises
    ------
    PosteriorError
        When more are asked for than there are.
    """
    for name, asked in (("draws", options.draws), ("draws_per_reading", options.draws_per_reading)):
        if asked is not None and asked > available:
            raise PosteriorError(
                f"expected {name} of at most {available}, the number of draws in the posterior, but got {asked}; "
                "ask for fewer, or calibrate with more draws"
            )
    count = min(_DRAWS, available) if options.draws is None else options.draws
    if options.draws_per_reading is not None:
        # Asking for many draws per reading asks for as many to choose from.
        count = max(count, options.draws_per_reading) if options.draws is None else count
        if options.draws_per_reading > count:
            raise PosteriorError(
                f"expected draws_per_reading of at most {count}, the draws that are used, but got "
                f"{options.draws_per_reading}; ask for fewer"
            )
    return count, min(_DRAWS_PER_READING, count) if options.draws_per_reading is None else options.draws_per_reading


def _from_posterior(
    names: Sequence[str], posterior: Posterior, method: str, options: FilterOptions
) -> tuple[Float, int]:
    if method != "posterior":
        found = posterior_mean(posterior) if method == "mean" else map_estimate(posterior)
        return np.array([[found[name] for name in names]]), 1
    position = {name: k for k, name in enumerate(parameter_names(posterior))}
    flat = theta_draws(posterior)[..., [position[name] for name in names]].reshape(-1, len(names))
    count, picks = default_draws(options, len(flat))
    # Evenly along each chain, chain after chain.
    return flat[np.linspace(0, len(flat) - 1, count).round().astype(int)].copy(), picks


def _require_possible(bound: BoundModel, values: Float) -> None:
    """Check that what comes from a posterior can be used: no negative noise, no weight beyond 1."""
    for parameter, column in zip(bound.parameters, values.T, strict=True):
        low, high = {"noise": (0.0, math.inf), "noise growth": (0.0, math.inf), "weight": (0.0, 1.0)}.get(
            parameter.role, (-math.inf, math.inf)
        )
        usable = np.isfinite(column) & (column >= low) & (column <= high)
        if parameter.role == "noise":
            usable &= column > 0.0
        if not usable.all():
            raise PosteriorError(
                f"expected draws of {parameter.name} that it can have ({ROLES[parameter.role]}), but got "
                f"{column[int(np.argmin(usable))]:g}; give the posterior that 'pmcl calibrate' wrote"
            )


def _check_names(bound: BoundModel, posterior: Posterior) -> None:
    found, expected = parameter_names(posterior), bound.names
    if set(found) != set(expected):
        raise PosteriorError(
            f"expected a posterior of the model's parameters {', '.join(expected)} ({bound.logs[0].where}), but the "
            f"posterior has {', '.join(found)}; use the model that was calibrated, or calibrate this one"
        )


def _checked(bound: BoundModel, theta: Mapping[str, float]) -> dict[str, float]:
    check_type("theta", theta, Mapping, error=ModelError, advice="write a dict with parameter names as keys")
    known = {parameter.name: parameter for parameter in bound.parameters}
    for name, value in theta.items():
        if name not in known:
            advice = did_you_mean(name, known, "leave it out")
            raise ModelError(f"theta: expected parameters out of {', '.join(known)}, but got '{name}'; {advice}")
        _check_value(known[name], value)
    return {name: float(value) for name, value in theta.items()}


def _check_value(parameter: Parameter, value: float) -> None:
    check_number(f"theta: {parameter.name}", value, error=ModelError, advice="choose another value")
    low, high = prior_support(parameter.prior)
    if not (math.isfinite(value) and low <= value <= high):
        raise ModelError(
            f"theta: expected {parameter.name} within its prior, {low:g} to {high:g}, but got {value:g}; "
            "choose another value"
        )
    if parameter.role == "noise" and value == 0.0:
        raise ModelError(f"theta: expected {parameter.name} > 0, but got 0; choose a small one, such as 0.001")
