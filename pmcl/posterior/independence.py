"""Whether chains are evidence of their own: walkers of an ensemble, restarted chains, paths that stayed.

R-hat and effective draws take chains for independent. Walkers of an ensemble propose from each other. A chain that was
restarted from another one agrees with it because it is a copy, not because both found the same place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.posterior.compat import Posterior, mean_ess
from pmcl.posterior.settings import settings

__all__ = ["Independence", "ensemble_bulk_ess", "ensemble_tail_ess", "independence"]

Float = NDArray[np.float64]

# Above this share of dead sweeps among those since drawing began, what was drawn is not what the model says. A chain of
# four that stands still for the last twenty-fifth of the run reaches it.
_DEAD_SHARE = 0.01
# Quantiles whose effective draws are those of the tails.
_TAILS = (0.05, 0.95)


class Independence(NamedTuple):
    """What a run tells about its chains.

    Attributes
    ----------
    ensemble : bool
        Whether the chains are walkers of an ensemble.
    copies : dict of int to int
        Restarted chain to the chain of which it is a copy.
    beginnings : int
        How many chains began by themselves and were not restarted.
    dead_share : float
        Share of the sweeps since drawing began in which every particle was impossible; 0 when that is not known.
    """

    ensemble: bool
    copies: dict[int, int]
    beginnings: int
    dead_share: float

    @property
    def complaints(self) -> tuple[str, ...]:
        """What denies convergence, as parts of a sentence."""
        said = []
        if self.copies and self.beginnings < 2:
            said.append("all chains are copies of one, restarted from it, so that their agreement tells nothing")
        if self.dead_share > _DEAD_SHARE:
            said.append(
                f"in {100.0 * self.dead_share:.2g} % of the sweeps since drawing began every particle was impossible, "
                "so that the path stayed"
            )
        return tuple(said)

    @property
    def advice(self) -> tuple[str, ...]:
        """Advice for the user; it warns of copies also where enough chains are none."""
        said = []
        if self.copies:
            which = ", ".join(f"{chain} (from {source})" for chain, source in sorted(self.copies.items()))
            said.append(
                f"Restarted during burn-in, so no evidence that all beginnings lead to one place: chain {which}. "
                "Calibrate again with more particles during burn-in, or with another seed."
            )
        if self.dead_share > _DEAD_SHARE:
            said.append("Use more particles, or a model with outliers: no particle could explain some readings.")
        return tuple(said)


def independence(data: Posterior, chains: int, draws: int) -> Independence:
    """Return what a run tells about its chains; a posterior of another program tells nothing, which is no complaint.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    chains, draws : int
        Number of chains K, and of draws N of each.

    Returns
    -------
    Independence
    """
    told = settings(data)
    origins = [int(word) for word in str(told.get("chain_origins", "")).split() if word.isdecimal()]
    if len(origins) != chains:
        origins = list(range(chains))
    dead, sweeps = told.get("dead_sweeps_while_drawing", 0), told.get("sweeps_per_draw", 1)
    share = 0.0
    if isinstance(dead, int | float) and isinstance(sweeps, int | float) and sweeps > 0:
        share = float(dead) / (chains * draws * float(sweeps))
    return Independence(
        ensemble=told.get("dependent_chains") is True,
        copies={chain: origin for chain, origin in enumerate(origins) if chain != origin},
        beginnings=len(set(origins)),
        dead_share=share,
    )


def ensemble_bulk_ess(draws: Float) -> float:
    """Effective number of draws for the centre of the distribution, of walkers that depend on each other.

    Parameters
    ----------
    draws : ndarray, shape (K, N)
        N steps of K walkers.

    Returns
    -------
    float
        NaN for fewer than four steps, and for draws that are all equal.
    """
    ranks = stats.rankdata(draws, axis=None).reshape(draws.shape)
    return _of_mean(stats.norm.ppf((ranks - 0.375) / (draws.size + 0.25)))


def ensemble_tail_ess(draws: Float) -> float:
    """Effective number of draws for the 5 % and 95 % quantiles, the smaller one, of walkers that depend on each other.

    Parameters
    ----------
    draws : ndarray, shape (K, N)
        N steps of K walkers.

    Returns
    -------
    float
        NaN for fewer than four steps, and for draws that are all equal.
    """
    return float(min(_of_mean((draws <= np.quantile(draws, tail)).astype(np.float64)) for tail in _TAILS))


def _of_mean(values: Float) -> float:
    """Return how many independent draws have a mean as precise as that of all values (K, N).

    The ensemble is one chain, whose step is one draw of all walkers: the mean over the walkers is a stationary series,
    and holds all dependence between them (Goodman, Weare, CAMCoS 5, 2010, section 3).
    """
    mean = values.mean(axis=0)
    spread, spread_of_mean = float(values.var()), float(mean.var())
    if spread == 0.0 or spread_of_mean == 0.0:
        return float("nan")
    return mean_ess(mean[None, :]) * spread / spread_of_mean
