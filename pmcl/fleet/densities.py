"""What one robot's log says about one parameter, apart from the prior, as numbers at nodes.

Parameters are taken to the whole real line first (:class:`pmcl.sampling.transforms.Unconstrained`): an amount of noise
by its logarithm, so that the spread of a fleet is a ratio.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.models.parameters import Parameter
from pmcl.sampling.transforms import Unconstrained

__all__ = ["Line", "RobotDensity", "robot_density"]

Float = NDArray[np.float64]

# Nodes of a density, and draws that it is made of at most: the curve then errs by some per cent of its height.
_NODES, _DRAWS = 80, 4000
# Silverman's bandwidth for densities that may not be Gaussian (1986, eq. 3.31), and how far beyond the outermost draw
# nodes reach, in bandwidths.
_SILVERMAN, _REACH = 0.9, 4.0
# Probabilities at which the prior's mean and standard deviation on the line are summed up.
_QUANTILES = (np.arange(2000) + 0.5) / 2000


class Line:
    """The real line on which a parameter is compared between robots, with its prior there.

    Parameters
    ----------
    parameter : Parameter

    Attributes
    ----------
    prior_mean, prior_sd : float
        Mean and standard deviation of the prior on the line.
    ratio : bool
        Whether differences on the line are logarithms of ratios.
    """

    def __init__(self, parameter: Parameter) -> None:
        self.parameter = parameter
        self._transform = Unconstrained([parameter])
        self.ratio = bool(self._transform.kind[0] == 1 and self._transform.low[0] == 0.0)
        # A prior that piles up at an edge of its support has its quantiles within rounding of it.
        values = parameter.prior.ppf(_QUANTILES)
        inside = values[(values > self._transform.low[0]) & (values < self._transform.high[0])]
        u = self.to_line(inside)
        self.prior_mean, self.prior_sd = float(u.mean()), float(u.std())

    def to_line(self, theta: Float) -> Float:
        """Return places on the line for values of the parameter, both of any shape."""
        return np.asarray(self._transform.to_line(np.asarray(theta, dtype=float)[..., None])[..., 0])

    def from_line(self, u: Float) -> Float:
        """Undo :meth:`to_line`."""
        flat = np.asarray(u, dtype=float).reshape(-1)
        values = np.array([self._transform.from_line(np.array([x]))[0][0] for x in flat], dtype=np.float64)
        return np.asarray(values.reshape(np.shape(u)))

    def log_prior(self, u: Float) -> Float:
        """Return the log density of the prior on the line, at places of shape (M,)."""
        pairs = [self._transform.from_line(np.array([x])) for x in u]
        theta = np.array([pair[0][0] for pair in pairs])
        log_jacobian = np.array([pair[1] for pair in pairs])
        return np.asarray(self.parameter.prior.logpdf(theta) + log_jacobian, dtype=np.float64)


class RobotDensity(NamedTuple):
    """One robot's posterior and likelihood of one parameter at M nodes of equal distance.

    Attributes
    ----------
    nodes : ndarray, shape (M,)
        Places on the line.
    step : float
        Distance of neighbours.
    posterior : ndarray, shape (M,)
        Probability around each node; sums to 1.
    likelihood : ndarray, shape (M,)
        Likelihood times `step`, so scaled that its product with the prior density sums to 1.
    """

    nodes: Float
    step: float
    posterior: Float
    likelihood: Float


def robot_density(draws: Float, line: Line) -> RobotDensity:
    """Turn draws of one parameter into densities.

    Parameters
    ----------
    draws : ndarray, shape (S,)
        Draws of the posterior, in the parameter's unit.
    line : Line
        The parameter's line.

    Returns
    -------
    RobotDensity

    Notes
    -----
    A kernel estimate whose draws are moved towards their mean so that kernels add no variance (West, Approximating
    posterior distributions by mixtures, J. R. Stat. Soc. B 55(2), 1993). The likelihood is posterior over prior.
    """
    kept = draws[np.linspace(0, draws.size - 1, min(draws.size, _DRAWS)).astype(np.int64)]
    u = line.to_line(kept)
    mean, sd = float(u.mean()), float(u.std())
    quartiles = np.quantile(u, (0.25, 0.75))
    scale = min(sd, float(quartiles[1] - quartiles[0]) / 1.34) or sd
    # Draws that are all alike, as of a parameter that a chain never moved, have no density; a narrow one stands for it.
    width = max(_SILVERMAN * scale * u.size**-0.2, 1e-6 * line.prior_sd)
    centres = mean + np.sqrt(max(1.0 - (width / sd) ** 2, 0.0)) * (u - mean) if sd > 0.0 else u
    nodes = np.linspace(centres.min() - _REACH * width, centres.max() + _REACH * width, _NODES)
    step = float(nodes[1] - nodes[0])
    density = np.exp(-0.5 * ((nodes[:, None] - centres) / width) ** 2).sum(axis=1)
    posterior = density / density.sum()
    log_prior = line.log_prior(nodes)
    ratio = np.zeros(_NODES)
    allowed = np.isfinite(log_prior)
    ratio[allowed] = posterior[allowed] * np.exp(-log_prior[allowed])
    return RobotDensity(nodes, step, posterior, ratio)
