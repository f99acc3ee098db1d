"""Bayesian calibration for Monte Carlo localization.

From what a robot logged (odometry, range or landmark readings) and a map to the posterior of the noise parameters of
its motion and sensors, after Kaboli, Bowling, Musilek (AAAI 2006)::

    import pmcl

    log = pmcl.read_log("robot.nc")             # or pmcl.simulate_amigobot()
    data = pmcl.calibrate(log, progress=True)   # an ArviZ posterior
    print(pmcl.verdict(data).message)
    pmcl.write_posterior(data, "posterior.nc")

Names are imported when they are first used.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.calibration.particle_gibbs import ParticleGibbs
    from pmcl.calibration.workflow import calibrate
    from pmcl.criticism.workflow import criticize
    from pmcl.errors import PmclError
    from pmcl.localization.many import localize_many
    from pmcl.localization.offline import localize
    from pmcl.logs.robot_log import RobotLog
    from pmcl.maps.landmarks import LandmarkMap
    from pmcl.maps.walls import WallMap
    from pmcl.models.parameters import Parameter
    from pmcl.models.robot_model import RobotModel, default_model
    from pmcl.posterior.diagnostics import verdict
    from pmcl.posterior.files import read_posterior, write_posterior
    from pmcl.sampling.move import ParticleGibbsMove
    from pmcl.simulations.aibo import simulate_aibo
    from pmcl.simulations.amigobot import simulate_amigobot

    __version__: str

__all__ = [
    "LandmarkMap",
    "Parameter",
    "ParticleGibbs",
    "ParticleGibbsMove",
    "PmclError",
    "RobotLog",
    "RobotModel",
    "WallMap",
    "__version__",
    "calibrate",
    "criticize",
    "default_model",
    "localize",
    "localize_many",
    "read_log",
    "read_posterior",
    "simulate_aibo",
    "simulate_amigobot",
    "verdict",
    "write_posterior",
]

_HOMES = {
    "LandmarkMap": "pmcl.maps.landmarks",
    "Parameter": "pmcl.models.parameters",
    "ParticleGibbs": "pmcl.calibration.particle_gibbs",
    "ParticleGibbsMove": "pmcl.sampling.move",
    "PmclError": "pmcl.errors",
    "RobotLog": "pmcl.logs.robot_log",
    "RobotModel": "pmcl.models.robot_model",
    "WallMap": "pmcl.maps.walls",
    "calibrate": "pmcl.calibration.workflow",
    "criticize": "pmcl.criticism.workflow",
    "default_model": "pmcl.models.robot_model",
    "localize": "pmcl.localization.offline",
    "localize_many": "pmcl.localization.many",
    "read_posterior": "pmcl.posterior.files",
    "simulate_aibo": "pmcl.simulations.aibo",
    "simulate_amigobot": "pmcl.simulations.amigobot",
    "verdict": "pmcl.posterior.diagnostics",
    "write_posterior": "pmcl.posterior.files",
}


def read_log(path: str | os.PathLike[str]) -> RobotLog:
    """Read a robot log from its NetCDF file.

    Parameters
    ----------
    path : path
        A file that ``pmcl simulate``, ``pmcl convert`` or :meth:`~pmcl.logs.robot_log.RobotLog.write` wrote.

    Returns
    -------
    RobotLog

    Raises
    ------
    LogError, MapError
        When the file is missing, damaged, or not a valid log.
    """
    from pmcl.logs.robot_log import RobotLog

    return RobotLog.read(path)


_getattr, _ = lazy_names(__name__, _HOMES)


def __getattr__(name: str) -> Any:
    if name != "__version__":
        return _getattr(name)
    from importlib.metadata import version

    return version("pmcl")


def __dir__() -> list[str]:
    return sorted(__all__)
