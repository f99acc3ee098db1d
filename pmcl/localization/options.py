"""How a localizing filter works, beyond its number of particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmcl.checks import check_choice, check_flag, check_number, check_whole
from pmcl.engine.scalars import TURN
from pmcl.errors import FilterError
from pmcl.filtering.kernels.resampling import SCHEMES
from pmcl.filtering.tracker import Options
from pmcl.models.starts.table import PoseStart

__all__ = ["FilterOptions"]

# Particles for each square metre that a robot may be on when its place is unknown, and the greatest number that is
# chosen without being asked for, which needs some 80 MB.
_PER_SQUARE_METRE, _MOST_CHOSEN = 50.0, 200_000

# Bins in which KLD-sampling counts particles, its bound, and the 99 % normal quantile (Fox 2003, section 4).
_BIN_SIZE, _BIN_TURN, _KLD_ERROR, _KLD_QUANTILE = 0.2, np.radians(15.0), 0.05, 2.3263
# Rates of the two averages of Gutmann and Fox (2002), for rows of so many independent readings, and the tolerance: one
# odd row is forgiven, two are not. Rows of fewer readings scatter more, so more of them are averaged.
_FAST, _SLOW, _USUAL_READINGS, _TOLERANCE = 0.4, 0.02, 8.0, 2.0


@dataclass(frozen=True)
class FilterOptions:
    """Options of the localizing filter.

    Attributes
    ----------
    draws : int, optional
        Draws K of the posterior that the method ``posterior`` works with, evenly out of all chains; 100, or all when
        there are fewer.
    draws_per_reading : int, optional
        How many of them each row's readings are averaged over (the k of eq. 24), chosen anew at each row; 10, or all
        when there are fewer.
    scheme : {"multinomial", "systematic", "stratified", "residual"}
        How parents are drawn; the paper's is multinomial.
    threshold : float
        Resample where the effective sample size is at most this share of the particles: 1 always, 0 never.
    annealed : bool
        Take in the first reading by degrees when the start is unknown: see
        :mod:`pmcl.filtering.kernels.tracking.anneal`.
    recover : bool
        Look for the robot elsewhere when its readings suddenly become unlikely, as after being carried away.
    least_particles : int, optional
        Let the number of particles follow the spread of the belief, from this many up to the number given (KLD
        sampling). By default the number given is also the least.
    start_particles : int, optional
        Greatest number of particles: while the place of the robot is unknown, at the first row or when it is looked
        for elsewhere. They become fewer as the belief narrows, down to the number given. By default 50 for each square
        metre that the robot may be on, where its place is unknown or it is looked for, else the number given.

    Notes
    -----
    Why 10 draws per reading (``analyses/draws_per_reading``; four logs, posteriors from one minute of data, n = 500,
    against 50 draws): with 1, 2, 5, 10, 20 draws the position error is 0.2, 0.2, 0.1, 0.0, 0.2 % greater, with a
    standard error of 0.1 %, so it hardly depends on k; the log score is lower by 0.010, 0.004, 0.003, 0.002, 0.003 nat
    a row, and the time a row 82, 91, 114, 149, 221 and with 50 draws 449 microseconds. Draws that are chosen once for
    the whole run are up to 2.5 % worse and depend on luck: hence anew at each row.

    In the L-shaped room of the Amigobot a start anywhere needs no more than the usual 500 particles with the annealed
    first reading: 100 of 100 starts converge with 500, 98 and 99 (usual and sharp readings) with 200, 94 and 95 with
    100. Without annealing it is 75 and 69 with 500, and 95 and 85 with 5000.

    Scans whose beams are tempered tell little each, so the belief stays wide for many rows, and particles must cover
    it. In Wean Hall (483 m^2, a corridor whose doors look alike) 4 of 24 starts find the robot with 500 particles; of
    100 starts with 5, 10, 20 and 50 for each square metre 63, 87, 97 and 99 do.
    A filter that begins with 50 and then follows its belief needs 0.2 s for the 132 s of this log.

    References
    ----------
    Fox, Adapting the sample size in particle filters through KLD-sampling, IJRR 22(12), 2003.
    Gutmann, Fox, An experimental comparison of localization methods continued, IROS 2002.
    Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 8.3 (augmented MCL).
    """

    draws: int | None = None
    draws_per_reading: int | None = None
    scheme: str = "multinomial"
    threshold: float = 1.0
    annealed: bool = True
    recover: bool = False
    least_particles: int | None = None
    start_particles: int | None = None

    def __post_init__(self) -> None:
        """Check all values; raises FilterError."""
        check_choice("scheme", self.scheme, sorted(SCHEMES), error=FilterError)
        check_number("threshold", self.threshold, 0.0, 1.0, error=FilterError, advice="1 is always")
        for name in ("annealed", "recover"):
            check_flag(name, getattr(self, name), error=FilterError)
        for name in ("draws", "draws_per_reading"):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 1, error=FilterError, advice="10 are usual")
        for name in ("least_particles", "start_particles"):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 2, error=FilterError, advice="100 to 10000 are usual")

    def most_particles(self, particles: int, start: object, elsewhere: object = None) -> int:
        """Return the greatest number of particles that the filter will have.

        Parameters
        ----------
        particles : int
            Number of particles once the place of the robot is known.
        start, elsewhere : NamedTuple
            Start table, and that of a robot that was carried away; None without recovery.
        """
        if self.start_particles is not None:
            return max(particles, self.start_particles)
        areas = [_area(table) for table in (start, elsewhere) if _is_somewhere(table)]
        return max(particles, min(round(_PER_SQUARE_METRE * max(areas, default=0.0)), _MOST_CHOSEN))

    def for_kernel(
        self, particles: int, draws: int, picks: int, start: object, elsewhere: object = None
    ) -> Options:
        """Return the same as numbers.

        Parameters
        ----------
        particles : int
            Number of particles once the place of the robot is known.
        draws, picks : int
            Draws K, and draws per reading.
        start, elsewhere : NamedTuple
            Start table: whether pose or heading are unknown decides on annealing and on the number of particles; and
            the start table of a robot that was carried away, None without recovery.

        Raises
        ------
        FilterError
            When there are fewer than 2 particles, or fewer than `least_particles`.
        """
        least = particles if self.least_particles is None else self.least_particles
        if not 2 <= least <= particles:
            raise FilterError(
                f"expected at least {max(2, least)} particles, but got {particles}; 25 to 1000 are usual, "
                "several thousand for a start anywhere"
            )
        annealed = 0
        # States with more than a pose begin with a belief about the pose too.
        pose = getattr(start, "pose", start)
        if self.annealed and isinstance(pose, PoseStart):
            annealed = 2 if bool(np.isinf(pose.std).all()) else 1
        most = self.most_particles(particles, start, elsewhere)
        first = most if self.start_particles is not None or _is_somewhere(start) else particles
        return Options(
            first, least, most, draws, picks, SCHEMES[self.scheme],
            float(self.threshold), annealed, self.recover, _FAST, _SLOW, _USUAL_READINGS, _TOLERANCE,
            _BIN_SIZE, float(_BIN_TURN), _KLD_ERROR, _KLD_QUANTILE,
        )  # fmt: skip


def _is_somewhere(start: object) -> bool:
    """Return whether a start table leaves the position open."""
    # States with more than a pose begin with a belief about the pose too.
    pose = getattr(start, "pose", start)
    return isinstance(pose, PoseStart) and bool(np.isinf(pose.std[0]))


def _area(start: object) -> float:
    """Return the area [m^2] over which the position of a start table is uniform."""
    pose = getattr(start, "pose", start)
    assert isinstance(pose, PoseStart)
    return float(np.exp(-pose.log_density) / (TURN if np.isinf(pose.std[2]) else 1.0))
