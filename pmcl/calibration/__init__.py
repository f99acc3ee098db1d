"""Calibration: from logs to the posterior of a robot's noise parameters, by one of several methods.

:func:`calibrate` does everything that is the same for all methods: it checks the logs, binds the model, runs the
method, labels its result and checks the calibrated model. A method is a class of its own, whose fields are its
settings.

Of the posterior: :class:`ParticleGibbs`, the paper's sampler, :class:`MarginalGibbs`, :class:`TrajectorySets` and
:class:`NoUTurn`; :class:`Ensemble`, emcee's moves, and :class:`ParticleMetropolis`, plain and correlated, on the
filter's evidence; :class:`ExtendedKalman` and :class:`UnscentedKalman`; :class:`LiuWest` and :class:`Storvik`, with
parameters in the particles' state. Of one theta: :class:`ExpectationMaximisation`, :class:`OnlineOdometryBias`,
:class:`MeanFunctions`, :class:`LeastSquares`, :class:`EvidenceOptimiser`, and for comparison :class:`PriorMean` and the
oracle :class:`TrueResiduals`. Those that are exact only for some models say so.

To add a method, write one module with a subclass of :class:`CalibrationMethod` and register it
(:func:`pmcl.registry.register`, or the entry point group ``pmcl.methods``). :func:`calibrate`, ``pmcl calibrate
--method`` with an option for each setting, ``pmcl compare`` and the checkpoint then know it. Read
:mod:`~pmcl.calibration.method` first, then :mod:`~pmcl.calibration.ensemble` as the shorter example;
:mod:`~pmcl.calibration.settings` declares settings, :mod:`~pmcl.calibration.methods` finds methods by name,
:mod:`~pmcl.calibration.workflow` is :func:`calibrate`, and :mod:`~pmcl.calibration.tempering` chooses how far the
readings of a lidar are tempered. The work is done by :mod:`pmcl.sampling`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.calibration.andrews import TrajectorySets
    from pmcl.calibration.em import ExpectationMaximisation
    from pmcl.calibration.ensemble import Ensemble
    from pmcl.calibration.kalman import ExtendedKalman, UnscentedKalman
    from pmcl.calibration.least_squares import LeastSquares
    from pmcl.calibration.liu_west import LiuWest
    from pmcl.calibration.marginal_gibbs import MarginalGibbs
    from pmcl.calibration.method import CalibrationMethod, Variant
    from pmcl.calibration.nuts import NoUTurn
    from pmcl.calibration.optimiser import EvidenceOptimiser
    from pmcl.calibration.particle_gibbs import ParticleGibbs
    from pmcl.calibration.pmmh import ParticleMetropolis
    from pmcl.calibration.prior_mean import PriorMean
    from pmcl.calibration.roy_thrun import OnlineOdometryBias
    from pmcl.calibration.settings import setting
    from pmcl.calibration.storvik import Storvik
    from pmcl.calibration.stronger_stone import MeanFunctions
    from pmcl.calibration.tempering import Tempering, held_out_exponent, with_exponent
    from pmcl.calibration.truth import TrueResiduals
    from pmcl.calibration.workflow import calibrate
    from pmcl.sampling.chains import Chains, PointEstimate
    from pmcl.sampling.options import RunOptions

__all__ = [
    "CalibrationMethod",
    "Chains",
    "Ensemble",
    "EvidenceOptimiser",
    "ExpectationMaximisation",
    "ExtendedKalman",
    "LeastSquares",
    "LiuWest",
    "MarginalGibbs",
    "MeanFunctions",
    "NoUTurn",
    "OnlineOdometryBias",
    "ParticleGibbs",
    "ParticleMetropolis",
    "PointEstimate",
    "PriorMean",
    "RunOptions",
    "Storvik",
    "Tempering",
    "TrajectorySets",
    "TrueResiduals",
    "UnscentedKalman",
    "Variant",
    "calibrate",
    "held_out_exponent",
    "setting",
    "with_exponent",
]

_HOMES = {
    "CalibrationMethod": "pmcl.calibration.method",
    "Chains": "pmcl.sampling.chains",
    "Ensemble": "pmcl.calibration.ensemble",
    "EvidenceOptimiser": "pmcl.calibration.optimiser",
    "ExpectationMaximisation": "pmcl.calibration.em",
    "ExtendedKalman": "pmcl.calibration.kalman",
    "LeastSquares": "pmcl.calibration.least_squares",
    "LiuWest": "pmcl.calibration.liu_west",
    "MarginalGibbs": "pmcl.calibration.marginal_gibbs",
    "MeanFunctions": "pmcl.calibration.stronger_stone",
    "NoUTurn": "pmcl.calibration.nuts",
    "OnlineOdometryBias": "pmcl.calibration.roy_thrun",
    "ParticleGibbs": "pmcl.calibration.particle_gibbs",
    "ParticleMetropolis": "pmcl.calibration.pmmh",
    "PointEstimate": "pmcl.sampling.chains",
    "PriorMean": "pmcl.calibration.prior_mean",
    "RunOptions": "pmcl.sampling.options",
    "Storvik": "pmcl.calibration.storvik",
    "Tempering": "pmcl.calibration.tempering",
    "TrajectorySets": "pmcl.calibration.andrews",
    "TrueResiduals": "pmcl.calibration.truth",
    "UnscentedKalman": "pmcl.calibration.kalman",
    "Variant": "pmcl.calibration.method",
    "calibrate": "pmcl.calibration.workflow",
    "held_out_exponent": "pmcl.calibration.tempering",
    "setting": "pmcl.calibration.settings",
    "with_exponent": "pmcl.calibration.tempering",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
