"""Posteriors made up for localization: draws of given values, as ArviZ groups."""

from __future__ import annotations

import numpy as np
import xarray as xr

from pmcl.posterior.compat import assemble


def made_posterior(names, draws, lp=None, **attributes):
    """A posterior with `draws` (K, N, d) of the parameters `names`, and the joint density of each draw if given."""
    draws = np.asarray(draws, dtype=float)
    posterior = xr.Dataset({name: (("chain", "draw"), draws[..., k]) for k, name in enumerate(names)})
    statistics = {} if lp is None else {"lp": (("chain", "draw"), np.asarray(lp, dtype=float))}
    return assemble({"posterior": posterior, "sample_stats": xr.Dataset(statistics)}, attributes)


def around(theta, spread, shape=(2, 50), seed=0):
    """A posterior whose draws scatter log-normally around `theta`, a mapping of names to values."""
    rng = np.random.default_rng(seed)
    centre = np.array(list(theta.values()))
    draws = centre * np.exp(spread * rng.standard_normal((*shape, centre.size)))
    lp = -0.5 * ((np.log(draws / centre) / max(spread, 1e-9)) ** 2).sum(axis=-1)
    return made_posterior(tuple(theta), draws, lp)
