"""Localize a log in one pass."""

from __future__ import annotations

from collections.abc import Mapping

from pmcl import defaults
from pmcl.checks import check_seed
from pmcl.errors import FilterError
from pmcl.filtering.particle_filter import make_rng
from pmcl.localization.options import FilterOptions
from pmcl.localization.setup import prepare
from pmcl.localization.track import Track, make_track
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.compat import Posterior

__all__ = ["localize"]


def localize(
    log: RobotLog,
    model: RobotModel | None = None,
    posterior: Posterior | None = None,
    method: str = "mean",
    *,
    theta: Mapping[str, float] | None = None,
    particles: int = defaults.LOCALIZATION_PARTICLES,
    seed: int = 0,
    options: FilterOptions | None = None,
) -> Track:
    """Tell where a robot was at each row of its log, given what it had read up to then.

    Parameters
    ----------
    log : RobotLog
        What the robot measured, and the map.
    model : RobotModel, optional
        The model that was calibrated; the default model of the log when left out.
    posterior : arviz.InferenceData or xarray.DataTree, optional
        What :func:`pmcl.calibrate` returned; not needed when `theta` gives every parameter, or with ``prior``.
    method : {"mean", "map", "posterior", "prior"}
        ``mean``: theta at its posterior mean (eq. 18). ``map``: at the draw of the greatest joint density of
        theta and path (eq. 19), the paper's, which is no mode of theta alone and localizes a little worse.
        ``posterior``: each particle draws its own theta for each motion step (eq. 21), and its weight is the mean of
        the likelihoods under several draws (eq. 24). ``prior``: at the prior mean, as a baseline.
    theta : mapping of str to float, optional
        Values of parameters, instead of what the method gives.
    particles : int
        Number of particles n.
    seed : int
        All randomness follows from it.
    options : FilterOptions, optional
        Resampling, draws, global localization, recovery, adaptive numbers.

    Returns
    -------
    Track
        Cost: O(T n) times the cost of one reading's density, and of `draws_per_reading` densities for ``posterior``.

    Raises
    ------
    PmclError
        When log, model, posterior and settings do not fit each other, or the filter loses the robot.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006.
    """
    seed = check_seed(seed, error=FilterError)
    prepared = prepare(log, model, posterior, method, theta, particles, options)
    beliefs = prepared.tracker.run(0, log.n_steps, prepared.counts, make_rng(seed), log.where)
    given = theta is not None and set(theta) >= set(prepared.bound.names)
    settings = {"method": "theta" if given else method, "n": particles, "seed": str(seed)}
    return make_track(prepared, beliefs, settings)
