"""Parameters on the whole real line, where a Gaussian proposal in all dimensions fits them better."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmcl.models.parameters import Parameter, prior_support

__all__ = ["Unconstrained"]

Float = NDArray[np.float64]
_LINE, _HALF, _INTERVAL = 0, 1, 2


class Unconstrained:
    """The map u <-> theta: logarithm for a half line, logit for an interval, identity otherwise.

    Parameters
    ----------
    parameters : sequence of Parameter
        Their priors' supports choose the maps.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        supports = [prior_support(parameter.prior) for parameter in parameters]
        self.low = np.array([low for low, _ in supports])
        self.high = np.array([high for _, high in supports])
        self.kind = np.where(np.isinf(self.low), _LINE, np.where(np.isinf(self.high), _HALF, _INTERVAL))
        # Plain numbers: a loop over entries of arrays takes three times as long.
        self._rows = list(zip(self.kind.tolist(), self.low.tolist(), self.high.tolist(), strict=True))

    def to_line(self, theta: Float) -> Float:
        """Return u for theta, both (..., d)."""
        if theta.ndim == 1:
            with contextlib.suppress(ValueError):  # a logarithm of zero or less, which numpy has a value for
                return self._inside_to_line(theta)
        u = np.array(theta, dtype=float)
        half, interval = self.kind == _HALF, self.kind == _INTERVAL
        u[..., half] = np.log(theta[..., half] - self.low[half])
        share = (theta[..., interval] - self.low[interval]) / (self.high - self.low)[interval]
        u[..., interval] = np.log(share) - np.log1p(-share)
        return u

    def _inside_to_line(self, theta: Float) -> Float:
        """Do what :meth:`to_line` does for theta (d,) inside the support; numpy takes five times as long for so few."""
        u = theta.tolist()
        for k, (x, (kind, low, high)) in enumerate(zip(u, self._rows, strict=True)):
            if kind == _HALF:
                u[k] = math.log(x - low)
            elif kind == _INTERVAL:
                share = (x - low) / (high - low)
                u[k] = math.log(share) - math.log1p(-share)
        return np.array(u)

    def from_line(self, u: Float) -> tuple[Float, float]:
        """Return theta (d,) and the log of |d theta / d u| for u (d,)."""
        theta, log_jacobian = u.tolist(), 0.0
        for k, (x, (kind, low, high)) in enumerate(zip(theta, self._rows, strict=True)):
            if kind == _HALF:
                theta[k] = low + math.exp(min(x, 700.0))
                log_jacobian += x
            elif kind == _INTERVAL:
                width = high - low
                theta[k] = low + width / (1.0 + math.exp(-max(min(x, 700.0), -700.0)))
                log_jacobian += math.log(width) - abs(x) - 2.0 * math.log1p(math.exp(-abs(x)))
        return np.array(theta), log_jacobian
