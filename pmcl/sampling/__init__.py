"""Chains of parameters and trajectories, run by emcee; :mod:`pmcl.calibration` says with which settings.

Read in this order. What one chain does: :mod:`~pmcl.sampling.state` (the state of a chain and the report of a sweep),
:mod:`~pmcl.sampling.sweep` (one sweep of the paper's Table 1) with its two updates of theta,
:mod:`~pmcl.sampling.metropolis` and :mod:`~pmcl.sampling.transport`, and :mod:`~pmcl.sampling.move` (the sweep as an
emcee move). How a run is made of stages: :mod:`~pmcl.sampling.stages`, :mod:`~pmcl.sampling.tuning` (what a stage
uses of the one before), :mod:`~pmcl.sampling.advance` (emcee advances a stage) and
:mod:`~pmcl.sampling.particle_gibbs`. The other target, for emcee's own moves: :mod:`~pmcl.sampling.ensemble`. What
every run needs: :mod:`~pmcl.sampling.options`, :mod:`~pmcl.sampling.session`, :mod:`~pmcl.sampling.backends`,
:mod:`~pmcl.sampling.checkpoint`, :mod:`~pmcl.sampling.pool` and :mod:`~pmcl.sampling.stopwatch`. What comes out:
:mod:`~pmcl.sampling.chains`, which goes on to :mod:`pmcl.posterior`.
"""
