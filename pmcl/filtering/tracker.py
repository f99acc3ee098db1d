"""A localizing filter over the rows of coefficient tables: where the robot is, given everything up to now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine import contract
from pmcl.errors import DensityError, FilterError, ModelError
from pmcl.filtering.kernels.tracking import recovery, track
from pmcl.filtering.kernels.tracking.state import Options, new_state
from pmcl.filtering.kernels.weighing import ALL_ZERO, FINE, NOT_A_NUMBER
from pmcl.models.tables import Tables

__all__ = ["Beliefs", "Options", "Tracker", "stack_tables"]

Float = NDArray[np.float64]


class Beliefs(NamedTuple):
    """What the filter believes after each row.

    Attributes
    ----------
    mean : ndarray, shape (T, D)
        Mean state; component 2 of a pose is the circular mean, in [-pi, pi].
    covariance : ndarray, shape (T, D, D)
        Covariance about it.
    log_score : ndarray, shape (T,)
        Log predictive density of the readings at each row; 0 where nothing was measured.
    effective_size : ndarray, shape (T,)
        Effective sample size.
    particles : ndarray, shape (T,)
        Number of particles.
    """

    mean: Float
    covariance: Float
    log_score: Float
    effective_size: Float
    particles: Float


def stack_tables(tables: Sequence[Any]) -> Any:
    """Put the tables of K draws into one: fields that differ get a leading axis of length K, the others are shared.

    Parameters
    ----------
    tables : sequence of NamedTuple, tuple, ndarray or number
        Of one type; arrays of one shape.

    Returns
    -------
    The same type with stacked fields.

    Raises
    ------
    ModelError
        When the shape of a field differs between draws.
    """
    first = tables[0]
    if all(table is first for table in tables):
        return first
    if isinstance(first, tuple):
        parts = [stack_tables(column) for column in zip(*tables, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)
    if not isinstance(first, np.ndarray):
        return first if len(set(tables)) == 1 else np.array(tables)
    if any(table.shape != first.shape for table in tables):
        raise ModelError(
            f"expected tables of one shape for all draws of the parameters, but got a field of shape {first.shape} and "
            "one of another; localize with method 'mean' or 'map'"
        )
    if all(np.array_equal(table, first, equal_nan=table.dtype.kind == "f") for table in tables[1:]):
        return first
    return np.stack(tables)


class Tracker:
    """A filter with its memory, for tables of one theta or of many draws.

    Parameters
    ----------
    tables : sequence of Tables
        The tables of each of the K draws; one for a fixed theta.
    anywhere : NamedTuple, optional
        Start belief of a robot that may be anywhere, for recovery; that of the tables when left out.
    options : Options
        How to work; its `draws` must be K.
    """

    def __init__(self, tables: Sequence[Tables], anywhere: Any, options: Options) -> None:
        self.options = options
        self.use(tables)
        self.anywhere = self.tables.start if anywhere is None else anywhere
        self.size = int(contract.state_size(self.tables.motion))
        parts = (self.tables.motion, self.tables.start, self.anywhere)
        rows = [int(contract.scratch_rows(part)) for part in (*parts, *self.tables.sensors)]
        self._state = new_state(options, self.size, max(*rows, self.size, 3))

    def use(self, tables: Sequence[Tables]) -> None:
        """Replace the tables by others of the same types: a robot makes new ones for each time step."""
        self.tables = tables[0]
        self.stack = tables[0] if len(tables) == 1 else stack_tables(tables)

    def share(self) -> Tracker:
        """Return another filter on the same tables, with a memory of its own."""
        other = object.__new__(Tracker)
        other.__dict__.update(self.__dict__)
        other._state = new_state(self.options, self.size, self._state.scratch.size // self._state.log_weights.size)
        return other

    def forget(self) -> None:
        """Go back to where nothing has happened yet."""
        self._state.numbers[:] = 0.0
        self._state.shuffled[:] = np.arange(self._state.shuffled.size)

    def run(self, begin: int, end: int, counts: Float, rng: np.random.Generator, what: str) -> Beliefs:
        """Take in rows ``begin <= row < end`` of the tables.

        Parameters
        ----------
        begin, end : int
            Rows.
        counts : ndarray, shape (end - begin,)
            How many independent readings those of each row are worth, for recovery.
        rng : numpy.random.Generator
            Source of randomness.
        what : str
            For messages.

        Returns
        -------
        Beliefs
            Cost: O(n) for each row; memory O(n) besides the result.

        Raises
        ------
        FilterError
            When every particle gets weight zero.
        DensityError
            When a density is not a number.
        """
        beliefs, lost_at = self.run_until_lost(begin, end, counts, rng, what)
        if lost_at >= 0:
            raise FilterError(
                f"{what}: at row {lost_at} every particle has weight zero, so the filter has lost the robot; "
                "use more particles, a wider start belief, recovery, or a model with outliers",
                row=lost_at,
            )
        return beliefs

    def run_until_lost(
        self, begin: int, end: int, counts: Float, rng: np.random.Generator, what: str
    ) -> tuple[Beliefs, int]:
        """Do the same as :meth:`run`, but do not raise when the filter loses the robot.

        Parameters
        ----------
        begin, end, counts, rng, what
            As for :meth:`run`.

        Returns
        -------
        beliefs : Beliefs
            NaN from the row on at which the robot was lost.
        row : int
            That row, at which every particle got weight zero; -1 where there is none.

        Raises
        ------
        DensityError
            When a density is not a number.
        """
        n_rows = end - begin
        mean, covariance = np.full((n_rows, self.size), np.nan), np.full((n_rows, self.size, self.size), np.nan)
        # For each row: log score, effective sample size, number of particles.
        summary = np.full((n_rows, 3), np.nan)
        counts = np.asarray(counts, dtype=float)
        row, status = begin - 1, FINE
        while row < end - 1 and status == FINE:
            status, row = track.localize_rows(
                self.tables, self.stack, self.options, begin, row + 1, end, counts, rng, self._state,
                mean, covariance, summary,
            )  # fmt: skip
            i = row - begin
            if status == track.START_UNKNOWN:
                status = recovery.first_reading(
                    self.tables, self.stack, self.options, row, rng, self._state, mean[i], covariance[i], summary[i]
                )
            elif status == track.SOMEWHERE_ELSE:
                status = recovery.look_elsewhere(
                    self.tables, self.stack, self.anywhere, self.options, row, rng, self._state,
                    mean[i], covariance[i], summary[i],
                )  # fmt: skip
        if status == NOT_A_NUMBER:
            raise DensityError(
                f"{what}: at row {row} a density is not a number; check the coefficient tables of the model at that "
                "row",
                row=row,
            )
        summary[row + 1 - (status == ALL_ZERO) - begin :] = np.nan
        return Beliefs(mean, covariance, summary[:, 0], summary[:, 1], summary[:, 2]), row if status == ALL_ZERO else -1

    def particles(self) -> tuple[Float, Float]:
        """Return copies of the states (D, n) and their normalised weights (n,) after the last row."""
        n = int(self._state.numbers[0])
        weights = self._state.weights[:n]
        return self._state.particles[: self.size * n].reshape(self.size, n).copy(), weights / weights.sum()
