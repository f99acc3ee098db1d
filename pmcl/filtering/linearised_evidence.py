"""The evidence of a model that is linearised around a reference path, as a smooth function of theta.

With deviations d of the path from the reference, the log density of path and readings is, to second order,

    log p(reference, z | theta) + s(theta)' d - d' P(theta) d / 2,

where P is the block tridiagonal precision and s the shift that :func:`pmcl.filtering.kernels.linear.factorise`
eliminates: P = C C', k = P^-1 s row by row. Integrating d out gives

    log p(z | theta) = log p(reference, z | theta) + sum_t |C[t]' k[t]|^2 / 2 - sum_t log det C[t] + constant.

It is exact for a linear Gaussian model. The path is integrated out, so the information that a path would absorb is
already subtracted from its curvature (Louis, J. R. Stat. Soc. B 44, 1982, has the same difference as a formula). A
reading that cannot be linearised, such as a beam that crosses an edge, counts with its density at the reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.linear import factorise, standardised
from pmcl.filtering.not_a_number import check_density
from pmcl.filtering.particle_filter import log_joint
from pmcl.filtering.reading_information import information_of
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = ["LinearisedEvidence", "improved"]

Float = NDArray[np.float64]

# The reference is moved towards the mean of the linearised path at most so many times, each time by a step that is
# halved at most so often until the joint density grows, as long as it grows by more than this [nat].
_NEWTON_STEPS, _HALVINGS, _LEAST_GAIN = 12, 5, 0.05
# A reading with at least this probability of being no gross error counts as one that cannot be.
_WHOLE = 1.0 - 1e-9


class LinearisedEvidence:
    """A model linearised around one reference path for each log.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters at which the readings are linearised.
    references : sequence of ndarray, shape (T_l, D)
        Paths, headings not wrapped [m, m, rad].

    Attributes
    ----------
    references : tuple of ndarray, shape (T_l, D)
        The reference paths.

    Notes
    -----
    The linearisation is that of each sensor's room (:meth:`pmcl.models.sensor.Sensor.linearise`). The readings of a
    sensor that has none are expanded by differences of their log density instead, at every theta anew, which takes
    some ten times as long.
    """

    def __init__(self, bound: BoundModel, theta: Float, references: Sequence[Float]) -> None:
        self.bound = bound
        self.references = tuple(np.ascontiguousarray(reference) for reference in references)
        self._made_from = bound.tables(theta)
        self._readings = tuple(
            tuple(sensor_of(table).linearise(table, reference) for table in tables.sensors)
            for tables, reference in zip(self._made_from, self.references, strict=True)
        )

    def __call__(self, theta: Float) -> float:
        """Return the log evidence of all logs [nat], up to a constant; -inf where there is none.

        Parameters
        ----------
        theta : ndarray, shape (d,)
            Parameters.

        Raises
        ------
        DensityError
            When a density is not a number.
        """
        value = 0.0
        for number, tables in enumerate(self.bound.tables(theta)):
            reference = self.references[number]
            joint = check_density(log_joint(tables, reference), self.bound, theta, self.references)
            # The reference's own standardised deviations are -C[t]' k[t].
            log_determinant, z = standardised(*self.linear_model(number, tables), reference, reference)
            if not math.isfinite(log_determinant):
                return -math.inf
            value += joint - log_determinant + 0.5 * float(np.vdot(z, z))
        return value if math.isfinite(value) else -math.inf

    @property
    def is_gaussian(self) -> bool:
        """Whether every reading is linearised with its whole weight, as no gross error can be.

        The weights of mixtures are frozen with the linearisation, so that the evidence means something only near the
        theta that it was made at.
        """
        readings = [linear for of_log in self._readings for linear in of_log]
        return all(np.all(getattr(linear, "weight", 1.0) > _WHOLE) for linear in readings if linear is not None)

    def mean_path(self, theta: Float, number: int = 0) -> Float:
        """Return the mean of one log's linearised path, (T, D); the reference where there is none.

        Parameters
        ----------
        theta : ndarray, shape (d,)
            Parameters.
        number : int
            Which log.
        """
        reference = self.references[number]
        tables = self.bound.tables(theta)[number]
        log_determinant, _, gain, centre = factorise(*self.linear_model(number, tables), reference)
        if not math.isfinite(log_determinant):
            return reference
        size = reference.shape[1]
        deviation, gains = centre.copy(), gain.reshape(-1, size, size)
        for t in range(deviation.shape[0] - 2, -1, -1):
            deviation[t] += gains[t] @ deviation[t + 1]
        return np.asarray(reference + deviation)

    def linear_model(self, number: int, tables: Tables) -> tuple[Tables, tuple[object, ...]]:
        """Return tables and linearised readings of one log, as :func:`~.factorise` takes them.

        Parameters
        ----------
        number : int
            Which log.
        tables : Tables
            Coefficients of the log under some theta.
        """
        reference = self.references[number]
        sensors: list[NamedTuple] = []
        readings: list[object] = []
        for table, made_from, linear in zip(
            tables.sensors, self._made_from[number].sensors, self._readings[number], strict=True
        ):
            if linear is None:
                sensors.append(information_of(table, reference))
                readings.append(sensors[-1])
            else:
                sensors.append(table)
                readings.append(sensor_of(table).moved_linearisation(table, made_from, linear, reference))
        return tables._replace(sensors=tuple(sensors)), tuple(readings)


def improved(evidence: LinearisedEvidence, theta: Float) -> LinearisedEvidence:
    """Move the reference of a single log to the most probable path, as long as its density grows.

    Parameters
    ----------
    evidence : LinearisedEvidence
        Of one log.
    theta : ndarray, shape (d,)
        Parameters.

    Returns
    -------
    LinearisedEvidence
        Linearised around the better reference; `evidence` itself where none was found.
    """
    bound = evidence.bound
    tables = bound.tables(theta)[0]
    value = log_joint(tables, evidence.references[0])
    for _ in range(_NEWTON_STEPS):
        old = evidence.references[0]
        step = evidence.mean_path(theta) - old
        for halving in range(_HALVINGS):
            path = np.ascontiguousarray(old + 0.5**halving * step)
            found = log_joint(tables, path)
            if found > value:
                break
        else:
            return evidence
        evidence, grown, value = LinearisedEvidence(bound, theta, [path]), found - value, found
        if grown < _LEAST_GAIN:
            break
    return evidence
