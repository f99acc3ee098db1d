"""Student's t as a mixture of Gaussians, so that motion with heavy tails can be linearised.

Noise with Student's t, v degrees of freedom and scale s is Gaussian with standard deviation s / sqrt(w), if its
precision w is drawn from a gamma distribution of shape v / 2 and mean one (Dempster, Laird and Rubin 1980; West 1987,
Biometrika 74). Given the path and theta, the precisions are independent and gamma distributed again. A sweep therefore
draws them first and then moves theta and path with the precisions given: the motion is Gaussian meanwhile, and a step
that went far astray has a noise to match. Both parts leave the joint distribution of theta, path and precisions
unchanged, and with it that of theta and path.

Where a proposal changes v, the precisions either stay as they are, or follow: their logarithms keep their place, in
standard deviations from the mean of the distribution. The first serves where the readings tell of each step how far it
went astray, the second where they do not; half of the proposals do the one, half the other (compare the interweaving
of Yu and Meng 2011, J. Comput. Graph. Stat. 20).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma, polygamma

from pmcl.filtering.heavy_tails import given_precisions, inverse_freedom, motion_between_seams
from pmcl.filtering.kernels.linear import draw_precisions
from pmcl.models.tables import Tables

__all__ = ["Precisions", "heavy_tailed"]

Float = NDArray[np.float64]

# Inverse degrees of freedom from which on the precisions are worth drawing. Below, the noise is so nearly Gaussian that
# proposals are accepted more often without them, since the precisions tie down the degrees of freedom. Effective draws
# for each CPU second with and without: 14 and 55 between walls, where the posterior mean is 0.045; 6 and 3 in a
# landmark field with 0.10; 9 and 0.2 on Create 1 of MRCLAM with 0.49.
_HEAVY = 0.08
# Shape of a gamma distribution from which on two terms of Stirling's series leave out less than 1e-14.
_NEARLY_NORMAL = 1e4


@dataclass(frozen=True)
class Precisions:
    """The precisions of the noise of each log's steps, relative to its scale; none where all noise is Gaussian.

    Attributes
    ----------
    logs : tuple of ndarray, shape (T_l, 3)
        For each log: the logarithms of the precisions of forward, left and turn noise; 0 in rows that have none.
    used : tuple of ndarray of bool, shape (T_l,)
        For each log: the rows that have precisions, since a step of the path leads there.
    """

    logs: tuple[Float, ...] = ()
    used: tuple[NDArray[np.bool_], ...] = ()

    @classmethod
    def drawn(cls, all_tables: Sequence[Tables], paths: Sequence[Float], rng: np.random.Generator) -> Precisions:
        """Draw the precisions given the paths.

        Parameters
        ----------
        all_tables : sequence of Tables
            Coefficients of each log under some theta.
        paths : sequence of ndarray, shape (T_l, D)
            The path of each log.
        rng : numpy.random.Generator
            Source of randomness; not used where the noise is Gaussian.

        Returns
        -------
        Precisions
        """
        if not all(inverse_freedom(tables) > 0.0 for tables in all_tables):
            return cls()
        logs, used = [], []
        for tables, path in zip(all_tables, paths, strict=True):
            precision, drawn = draw_precisions(tables, path, rng)
            # The tables may have more rows than the path.
            further = motion_between_seams(tables).std.shape[0] - len(path)
            logs.append(np.pad(np.log(precision), ((0, further), (0, 0))))
            used.append(np.pad(drawn, (0, further)))
        return cls(tuple(logs), tuple(used))

    def given(self, all_tables: Sequence[Tables]) -> Sequence[Tables]:
        """Return tables of the model given the precisions: its motion has Gaussian noise."""
        if not self.logs:
            return all_tables
        return [given_precisions(*of_log) for of_log in zip(all_tables, self.logs, strict=True)]

    def following(self, old: Sequence[Tables], new: Sequence[Tables]) -> tuple[Precisions, float]:
        """Carry the precisions to other degrees of freedom: their logarithms keep their place in the distribution.

        Parameters
        ----------
        old, new : sequence of Tables
            Coefficients of each log under the current and the proposed theta.

        Returns
        -------
        carried : Precisions
        log_slope : float
            Log determinant of this map of the precisions' logarithms.
        """
        carried, log_slope = [], 0.0
        for before, after, log, used in zip(old, new, self.logs, self.used, strict=True):
            if not inverse_freedom(after) > 0.0:  # where no precision but one is possible
                return self, -math.inf
            centre, spread = _of_logarithms(inverse_freedom(before))
            new_centre, new_spread = _of_logarithms(inverse_freedom(after))
            carried.append(np.where(used[:, None], new_centre + new_spread / spread * (log - centre), 0.0))
            log_slope += 3 * np.count_nonzero(used) * math.log(new_spread / spread)
        return Precisions(tuple(carried), self.used), log_slope

    def log_density(self, all_tables: Sequence[Tables]) -> float:
        """Return the log density of the precisions' logarithms under the model of the tables."""
        value = 0.0
        for tables, log, used in zip(all_tables, self.logs, self.used, strict=False):  # none where all are Gaussian
            if not inverse_freedom(tables) > 0.0:
                return -math.inf
            shape, kept = 0.5 / inverse_freedom(tables), log[used]
            value += kept.size * _log_constant(shape) + shape * float((kept - np.expm1(kept)).sum())
        return value


def heavy_tailed(tables: Tables) -> bool:
    """Return whether the motion's noise strays so far from a Gaussian that its precisions are worth drawing."""
    return inverse_freedom(tables) > _HEAVY


def _log_constant(shape: float) -> float:
    """Return the log density at zero of the logarithm of a gamma variable of mean one."""
    if shape > _NEARLY_NORMAL:  # Stirling's series: the difference below would lose its digits
        return 0.5 * math.log(shape / (2.0 * math.pi)) - 1.0 / (12.0 * shape)
    return shape * math.log(shape) - shape - math.lgamma(shape)


def _of_logarithms(tail: float) -> tuple[float, float]:
    """Return mean and standard deviation of the logarithm of a precision, given the inverse degrees of freedom."""
    shape = 0.5 / tail
    return float(digamma(shape)) - math.log(shape), math.sqrt(float(polygamma(1, shape)))
