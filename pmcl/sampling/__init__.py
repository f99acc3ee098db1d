"""Chains of parameters and trajectories, run by emcee; :mod:`pmcl.calibration` says with which settings.

Read in this order. What one chain does: :mod:`~pmcl.sampling.state` (the state of a chain and the report of a sweep),
:mod:`~pmcl.sampling.sweep` (one sweep of the paper's Table 1) with its two updates of theta,
:mod:`~pmcl.sampling.metropolis` and :mod:`~pmcl.sampling.transport`, and :mod:`~pmcl.sampling.move` (the sweep as an
emcee move). How a run is made of stages: :mod:`~pmcl.sampling.stages`, :mod:`~pmcl.sampling.tuning` (what a stage
uses of the one before), :mod:`~pmcl.sampling.advance` (emcee advances a stage) and
:mod:`~pmcl.sampling.particle_gibbs`. The other target, for emcee's own moves: :mod:`~pmcl.sampling.ensemble`.

The methods that pmcl is compared with. Chains on theta alone: :mod:`~pmcl.sampling.random_walk`, with the evidence by
particles (:mod:`~pmcl.sampling.pseudo_marginal`, :mod:`~pmcl.sampling.particle_target`) or by Kalman filters
(:mod:`~pmcl.sampling.kalman`). Conditional SMC for two values of theta: :mod:`~pmcl.sampling.marginal_gibbs`. Clouds
of parameters: :mod:`~pmcl.sampling.parameter_filters`. One theta: :mod:`~pmcl.sampling.expectation`,
:mod:`~pmcl.sampling.online_bias`, :mod:`~pmcl.sampling.joint_mode`, :mod:`~pmcl.sampling.evidence_search`, and what
they share, :mod:`~pmcl.sampling.point_estimates`. Where the posterior is, roughly: :mod:`~pmcl.sampling.near_mode`,
by :mod:`~pmcl.sampling.approximate`.

What every run needs: :mod:`~pmcl.sampling.options`, :mod:`~pmcl.sampling.session`, :mod:`~pmcl.sampling.backends`,
:mod:`~pmcl.sampling.checkpoint`, :mod:`~pmcl.sampling.pool` and :mod:`~pmcl.sampling.stopwatch`. What comes out:
:mod:`~pmcl.sampling.chains`, which goes on to :mod:`pmcl.posterior`.
"""
