"""Summaries of the draws with their precision, and whether the chains have converged.

The measures are those of Vehtari, Gelman, Simpson, Carpenter, Bürkner, "Rank-normalization, folding, and localization:
an improved R-hat", Bayesian Analysis 16(2), 2021, as ArviZ computes them, with the limits recommended there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.checks import check_type
from pmcl.errors import PosteriorError
from pmcl.posterior.access import log_joint, parameter_names, parameter_units, theta_draws, true_theta
from pmcl.posterior.adequacy import adequacy
from pmcl.posterior.compat import Posterior, bulk_ess, find_group, mcse_of_mean, r_hat, tail_ess
from pmcl.posterior.independence import ensemble_bulk_ess, ensemble_tail_ess, independence
from pmcl.posterior.settings import settings

__all__ = ["ESS_LIMIT", "R_HAT_LIMIT", "Verdict", "lost_chains", "summarize", "verdict"]

Float = NDArray[np.float64]

R_HAT_LIMIT = 1.01
ESS_LIMIT = 400.0

# A chain is lost when it lies this many within-chain spreads below the best one. Medians of chains that visit the
# same places stay within one or two, even when they mix slowly; the lost mode of real logs is tens away.
_LOST_SPREADS = 5.0
_LEAST_FOR_SPREAD = 10

# Below this share of renewed path steps the filter has too few particles; a Metropolis step is badly scaled
# when it is accepted less or more often than these.
_PATH_UPDATE_LIMIT = 0.3
_ACCEPTANCE_LIMITS = (0.1, 0.8)

# Beyond this R-hat the chains are at different places, and no number of draws can be extrapolated.
_R_HAT_APART = 1.2

_POINT_ESTIMATE = "The method gives one estimate, without chains whose convergence could be judged."

# R-hat and ESS are defined from here on.
_LEAST_DRAWS = 4


class Verdict(NamedTuple):
    """Whether the chains have converged, and whether the model fits the log.

    Attributes
    ----------
    converged : bool
        Whether the draws are those of the model's posterior; True for a point estimate, which has no chains.
    adequate : bool or None
        Whether the calibrated model predicts its own log as well as it claims; None when that was not checked, as in
        files of older versions.
    message : str
        The verdict in words: the precision, or the parameter, chain or kind of reading that is wrong.
    advice : tuple of str
        Advice for the user, most urgent first; it may hold warnings when all is well.
    """

    converged: bool
    adequate: bool | None
    message: str
    advice: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the chains have converged and no check found the model inadequate."""
        return self.converged and self.adequate is not False


def summarize(data: Posterior) -> xr.Dataset:
    """Table of the posterior.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    xarray.Dataset
        Over the dimension ``parameter``: ``unit``, and in that unit ``mean``, ``sd``, ``mcse`` (Monte Carlo standard
        error of the mean), ``q5`` and ``q95`` (5 % and 95 % quantile), ``truth`` (NaN when unknown); without unit
        ``r_hat``, ``ess_bulk`` and ``ess_tail`` (of an ensemble: with its walkers' dependence).
        ``summarize(data).to_dataframe()`` gives a pandas table.

    Raises
    ------
    PosteriorError
        If the posterior holds no draws.
    """
    names, theta, truth = parameter_names(data), theta_draws(data), true_theta(data)
    flat = theta.reshape(-1, len(names))
    low, high = np.quantile(flat, [0.05, 0.95], axis=0)
    spread = flat.std(axis=0, ddof=1) if len(flat) > 1 else np.full(len(names), np.nan)
    bulk, tail, error = _each(bulk_ess, theta), _each(tail_ess, theta), _each(mcse_of_mean, theta)
    if independence(data, *theta.shape[:2]).ensemble:
        bulk = np.fmin(bulk, _each(ensemble_bulk_ess, theta))
        tail = np.fmin(tail, _each(ensemble_tail_ess, theta))
        error = np.fmax(error, spread / np.sqrt(bulk))
    columns = {
        "mean": flat.mean(axis=0),
        "sd": spread,
        "mcse": error,
        "q5": low,
        "q95": high,
        "r_hat": _each(r_hat, theta),
        "ess_bulk": bulk,
        "ess_tail": tail,
        "truth": np.array([truth.get(name, np.nan) for name in names]),
    }
    return xr.Dataset(
        {"unit": ("parameter", list(parameter_units(data)))} | {key: ("parameter", v) for key, v in columns.items()},
        coords={"parameter": list(names)},
        attrs={"chains": theta.shape[0], "draws": theta.shape[1]},
    )


def _each(measure: Callable[[Float], float], theta: Float) -> Float:
    return np.array([measure(np.ascontiguousarray(theta[..., index])) for index in range(theta.shape[-1])])


def lost_chains(log_densities: Float) -> dict[int, float]:
    """Chains whose log joint density lies far below that of the best chain.

    Slow chains differ in their medians by about the spread within a chain; a lost chain (such as one that takes every
    reading for an outlier) differs by many times that.

    Parameters
    ----------
    log_densities : ndarray, shape (K, N)
        Log joint densities [nat] of N draws of K chains.

    Returns
    -------
    dict of int to float
        Lost chain to how far [nat] its median lies below the median of the chains that are not lost. Empty for fewer
        than ten draws, of which neither spread nor median mean much.
    """
    if log_densities.shape[1] < _LEAST_FOR_SPREAD:
        return {}
    medians = np.median(log_densities, axis=1)
    low, high = np.quantile(log_densities, [0.25, 0.75], axis=1)
    # The spread is the median over chains, because a chain that still climbs has a large spread of its own. It is at
    # least one nat, because chains that hardly move would otherwise count each other as lost.
    spread = max(float(np.median((high - low) / 1.349)), 1.0)
    lost = medians < medians.max() - _LOST_SPREADS * spread
    level = float(np.median(medians[~lost]))
    return {int(chain): level - float(medians[chain]) for chain in np.flatnonzero(lost)}


def verdict(data: Posterior, summary: xr.Dataset | None = None) -> Verdict:
    """Judge a posterior: whether the chains have converged, and whether the model fits.

    Converged means: rank-normalised split R-hat at most 1.01 and at least 400 effective draws, in bulk and tails, for
    every parameter, no chain lost, at least two chains that are no copies of each other, and sweeps that move the path
    (:mod:`pmcl.posterior.independence`). Adequate means: the check that ends a calibration
    (:func:`pmcl.posterior.model_check.check_model`) found nothing unusual in the predictions of a filter with the
    posterior mean, and no mistake in the log was found before sampling.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    summary : xarray.Dataset, optional
        Result of :func:`summarize` for `data`, if it was computed already.

    Returns
    -------
    Verdict

    Raises
    ------
    PosteriorError
        If the posterior holds no draws, or the summary is of another posterior.
    """
    table = summarize(data) if summary is None else summary
    names = parameter_names(data)
    check_type("summary", table, xr.Dataset, error=PosteriorError, advice="make one with summarize(data)")
    if "parameter" not in table:
        raise PosteriorError("expected a summary with one row for each parameter, got none: call summarize(data)")
    if tuple(table["parameter"].values) != names:
        raise PosteriorError(
            f"expected the summary of this posterior ({', '.join(names)}), got one of "
            f"{', '.join(map(str, table['parameter'].values))}: call summarize on the same data"
        )
    fit = adequacy(data)
    if settings(data).get("point_estimate") is True:
        sentence = f" {fit.sentence[:1].upper()}{fit.sentence[1:]}." if fit.adequate is not None else ""
        return Verdict(True, fit.adequate, f"{_POINT_ESTIMATE}{sentence}", fit.advice)
    densities = log_joint(data)
    lost = lost_chains(densities) if densities is not None else {}
    short = _shortfalls(table)
    chains = independence(data, table.attrs["chains"], table.attrs["draws"])
    advice = (
        *_advice_on_chains(table, lost),
        *chains.advice,
        *_advice_on_draws(table, short, lost),
        *_advice_on_moves(data),
    )
    converged = not (lost or short or chains.complaints)
    if converged:
        least = float(min(table["ess_bulk"].min(), table["ess_tail"].min()))
        message = (
            f"Converged: R-hat is at most {float(table['r_hat'].max()):.3f} and there are at least {least:.0f} "
            f"effective draws for {_count(len(names), 'parameter')}."
        )
    else:
        message = _complaint(table, short, lost, chains.complaints)
    if fit.adequate is False:
        message += f" {'But' if converged else 'Besides,'} {fit.sentence}."
    elif fit.adequate and converged:
        message += f" {fit.sentence[:1].upper()}{fit.sentence[1:]}."
    return Verdict(converged, fit.adequate, message, (*advice, *fit.advice))


def _shortfalls(table: xr.Dataset) -> list[str]:
    """Return the parameters that miss a limit, the worst first; NaN misses it."""
    score = _shortfall_factor(table)
    order = np.argsort(-np.nan_to_num(score, nan=np.inf), kind="stable")
    return [str(table["parameter"].values[index]) for index in order if not score[index] <= 1.0]


def _shortfall_factor(table: xr.Dataset) -> Float:
    """Return by which factor each parameter misses its worst limit: so many times more draws it needs."""
    # R-hat exceeds 1 by an amount that falls like one over the number of draws.
    r_hat_factor = (table["r_hat"].values - 1.0) / (R_HAT_LIMIT - 1.0)
    least = np.minimum(table["ess_bulk"].values, table["ess_tail"].values)
    return np.asarray(np.maximum(r_hat_factor, ESS_LIMIT / np.maximum(least, 1e-12)), dtype=np.float64)


def _complaint(table: xr.Dataset, short: list[str], lost: dict[int, float], others: Sequence[str]) -> str:
    parts = [*([_lost_sentence(lost)] if lost else []), *others]
    if short:
        row = table.sel(parameter=short[0])
        if not np.isfinite(row["r_hat"]):
            parts.append(f"{short[0]} has no R-hat, which takes two chains of four draws that are not all equal")
        else:
            parts.append(
                f"{short[0]} has R-hat {float(row['r_hat']):.3f} (at most {R_HAT_LIMIT} is required), "
                f"{float(row['ess_bulk']):.0f} effective draws in bulk and {float(row['ess_tail']):.0f} in the tails "
                f"(at least {ESS_LIMIT:.0f} are required)"
            )
    if len(short) > 1:
        parts.append(f"{len(short)} of {table.sizes['parameter']} parameters fall short")
    return f"Not converged: {'; '.join(parts)}."


def _lost_sentence(lost: dict[int, float]) -> str:
    return "; ".join(
        f"chain {chain} is lost: its log joint is {gap:.0f} nats below the others" for chain, gap in lost.items()
    )


def _advice_on_chains(table: xr.Dataset, lost: dict[int, float]) -> list[str]:
    advice = []
    if lost:
        which = ", ".join(map(str, lost))
        advice.append(
            f"Calibrate again with more particles during burn-in, or another seed, so that chain {which} finds the "
            "place where the others are; its draws spoil every number below."
        )
    if table.attrs["chains"] < 2:
        advice.append("Run at least 2 chains, better 4: one chain alone cannot show that it has converged.")
    # Not exactly zero: the mean of equal numbers is rounded.
    constant = table["sd"].values <= 1e-12 * np.abs(table["mean"].values)
    still = [str(name) for name in table["parameter"].values[constant]]
    if still:
        advice.append(f"{', '.join(still)} never moved: check that the prior allows other values than the start.")
    return advice


def _advice_on_draws(table: xr.Dataset, short: list[str], lost: dict[int, float]) -> list[str]:
    # With a lost chain, or with a single one, R-hat and ESS do not show how many draws are needed.
    if not short or lost or table.attrs["chains"] < 2:
        return []
    if float(table["r_hat"].max()) > _R_HAT_APART:
        worst = str(table["parameter"].values[int(np.nanargmax(table["r_hat"].values))])
        return [f"The chains are at different places in {worst}: lengthen the burn-in before adding draws."]
    if table.attrs["draws"] < _LEAST_DRAWS:
        return [f"Run at least {ESS_LIMIT:.0f} draws per chain: so few tell nothing about convergence."]
    factor = float(np.nanmax([1.0, *_shortfall_factor(table)]))
    # Then only parameters that never moved miss a limit, and more draws do not help them.
    if factor <= 1.0:
        return []
    needed = table.attrs["draws"] * factor
    digits = 10.0 ** max(np.floor(np.log10(needed)) - 1.0, 0.0)
    return [
        f"Run about {np.ceil(needed / digits) * digits:.0f} draws per chain instead of {table.attrs['draws']}, "
        "or more transport moves per sweep."
    ]


def _advice_on_moves(data: Posterior) -> list[str]:
    statistics = find_group(data, "sample_stats")
    advice = []
    for key, values in statistics.data_vars.items():
        name = str(key).lower()
        if "path" in name and "update" in name:
            rate = float(values.mean())
            if rate < _PATH_UPDATE_LIMIT:
                advice.append(
                    f"A sweep renews only {100 * rate:.0f} % of the path: use more particles for the trajectory."
                )
        if "accept" in name:
            advice += _advice_on_acceptance(values)
    return advice


def _advice_on_acceptance(values: xr.DataArray) -> list[str]:
    low, high = _ACCEPTANCE_LIMITS
    rates = values.mean(dim=("chain", "draw"))
    labelled = zip(
        np.atleast_1d(rates["parameter"].values if "parameter" in rates.dims else str(values.name)),
        np.atleast_1d(rates.values),
        strict=True,
    )
    return [
        f"{name}: {100 * rate:.0f} % of the proposals are accepted ({100 * low:.0f} to {100 * high:.0f} % is healthy): "
        f"{'shorten' if rate < low else 'widen'} its steps, or lengthen the burn-in that adapts them."
        for name, rate in labelled
        # The rate of a move that was never proposed is NaN.
        if rate < low or rate > high
    ]


def _count(number: int, noun: str) -> str:
    return f"the {noun}" if number == 1 else f"each of {number} {noun}s"
