"""Calibration: from logs to the posterior of a robot's noise parameters, by one of several methods.

:func:`calibrate` does everything that is the same for all methods: it checks the logs, binds the model, runs the
method, labels its result and checks the calibrated model. A method is a class of its own, whose fields are its
settings: :class:`ParticleGibbs`, the paper's sampler, and :class:`Ensemble`, emcee's stretch move.

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
    from pmcl.calibration.ensemble import Ensemble
    from pmcl.calibration.method import CalibrationMethod, Variant
    from pmcl.calibration.particle_gibbs import ParticleGibbs
    from pmcl.calibration.settings import setting
    from pmcl.calibration.tempering import Tempering, held_out_exponent, with_exponent
    from pmcl.calibration.workflow import calibrate
    from pmcl.sampling.chains import Chains, PointEstimate
    from pmcl.sampling.options import RunOptions

__all__ = [
    "CalibrationMethod",
    "Chains",
    "Ensemble",
    "ParticleGibbs",
    "PointEstimate",
    "RunOptions",
    "Tempering",
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
    "ParticleGibbs": "pmcl.calibration.particle_gibbs",
    "PointEstimate": "pmcl.sampling.chains",
    "RunOptions": "pmcl.sampling.options",
    "Tempering": "pmcl.calibration.tempering",
    "Variant": "pmcl.calibration.method",
    "calibrate": "pmcl.calibration.workflow",
    "held_out_exponent": "pmcl.calibration.tempering",
    "setting": "pmcl.calibration.settings",
    "with_exponent": "pmcl.calibration.tempering",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
