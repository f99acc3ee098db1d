"""Shapes of single parameters: skewed and long-tailed distributions as transformed normal ones.

In unconstrained parameters a posterior is nearly normal in most directions, but not where it reaches down to a limit of
the prior: the logarithm of a noise that may be almost zero has a long tail to the left. The sinh-arcsinh transform
(Jones and Pewsey 2009, Biometrika 96) has two parameters for that, one of skewness and one of tails, and is a normal
distribution where they are 0 and 1:

    z = sinh(tail asinh((u - location) / scale) - skew),    z standard normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

__all__ = ["Marginals", "marginals_of"]

Float = NDArray[np.float64]

# Greatest skewness (chosen by hand; a noise that may be nearly zero has -0.6), and least and greatest tail parameter.
# Tails are never taken to be lighter than normal ones: a few hundred draws may lack a tail, and a chain that comes into
# a tail that its proposals lack stays there.
_MOST_SKEW, _TAILS = 1.0, (0.4, 1.0)


class Marginals(NamedTuple):
    """Sinh-arcsinh transforms of d parameters.

    Attributes
    ----------
    location, scale, skew, tail : ndarray, shape (d,)
        Their parameters.
    """

    location: Float
    scale: Float
    skew: Float
    tail: Float

    def to_normal(self, u: Float) -> Float:
        """Return standard normal values of parameters `u`, both (..., d)."""
        return np.asarray(np.sinh(self.tail * np.arcsinh((u - self.location) / self.scale) - self.skew))

    def from_normal(self, z: Float) -> Float:
        """Return the parameters that have standard normal values `z`, both (..., d)."""
        return np.asarray(self.location + self.scale * np.sinh((np.arcsinh(z) + self.skew) / self.tail))

    def to_normal_with_slope(self, u: Float) -> tuple[Float, Float]:
        """Return the values of :meth:`to_normal`, and the log of its derivative summed over parameters, (...)."""
        x = (u - self.location) / self.scale
        z = np.sinh(self.tail * np.arcsinh(x) - self.skew)
        # The derivative of sinh is cosh, and that of asinh the inverse of a square root: both follow from squares.
        slope = np.log(self.tail / self.scale).sum() + 0.5 * np.log((1.0 + z * z) / (1.0 + x * x)).sum(axis=-1)
        return z, np.asarray(slope)


def marginals_of(u: Float) -> Marginals:
    """Fit the shape of each parameter to draws, by maximum likelihood.

    Parameters
    ----------
    u : ndarray, shape (N, d)
        Draws in unconstrained parameters.

    Returns
    -------
    Marginals
    """
    fitted = np.array([_fit(draws) for draws in u.T])
    return Marginals(*(np.ascontiguousarray(column) for column in fitted.T))


def _fit(draws: Float) -> Float:
    """Return location, scale, skew and tail of the draws of one parameter, (N,)."""
    centre, spread = float(draws.mean()), float(draws.std()) or 1.0
    x = (draws - centre) / spread

    def cost(values: Float) -> float:
        location, log_scale, skew, log_tail = values
        one = Marginals(*(np.array([value]) for value in (location, np.exp(log_scale), skew, np.exp(log_tail))))
        z, log_slope = one.to_normal_with_slope(x[:, None])
        return float(np.mean(0.5 * z[:, 0] ** 2 - log_slope))

    bounds = [(-3.0, 3.0), (-3.0, 3.0), (-_MOST_SKEW, _MOST_SKEW), (np.log(_TAILS[0]), np.log(_TAILS[1]))]
    found = optimize.minimize(cost, np.zeros(4), method="L-BFGS-B", bounds=bounds)
    location, log_scale, skew, log_tail = found.x if found.fun < cost(np.zeros(4)) else np.zeros(4)
    return np.array([centre + spread * location, spread * np.exp(log_scale), skew, np.exp(log_tail)])
