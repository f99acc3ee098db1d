"""Particle Gibbs, the paper's sampler, with the exact trajectory kernel and transport moves besides."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from pmcl.calibration.method import CalibrationMethod, Variant
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import Chains
    from pmcl.sampling.options import RunOptions
    from pmcl.sampling.stages import Stage

__all__ = ["ParticleGibbs"]

# The conditional kernel is exact with any number of particles; the paper's is not, and needs many.
_PARTICLES: Final = {"conditional": 25, "smoothing": 500}
# Each sweep of the inclusion of data adds one such part of the longest log (the paper's r). With half of that
# burn-in takes longer, and ends in the same place.
_INCLUSION_SWEEPS: Final = 25
# While data is being included the path changes a lot from sweep to sweep, and theta has to follow.
_INCLUSION_METROPOLIS_STEPS: Final = 10
# A comparison stores every sweep, so that effective draws are counted for each of them.
_EVERY_SWEEP: Final = {"sweeps_per_draw": 1}
# Share of the last round of tuning whose draws shape the proposals of all that follow; of earlier rounds, in which
# chains still come together, it is half. Three runs of 400 rows with landmarks had 0.64 effective draws of the worst
# parameter for each draw with the last half of 120 sweeps, 0.74 with this share of them, 0.78 with that of 160.
_LAST_WINDOW: Final = 5 / 6
# About so many paths of a window are those that the linearised readings are fitted to. With a slope from 20, 40 or 160
# paths instead of one, robots between walls have 1.5 to 2.2 times the effective draws for the time.
_FITTED_PATHS: Final = 40
# How far one proposal moves the logs of the Metropolis steps during burn-in.
_GAIN: Final = 0.05


def _by_kernel(numbers: Mapping[str, int]) -> str:
    return ", ".join(f"{number} for {kernel}" for kernel, number in numbers.items())


@dataclass(frozen=True)
class ParticleGibbs(CalibrationMethod):
    """Table 1 of the paper: trajectories given theta by particle smoothing, theta given trajectories by Metropolis.

    Attributes
    ----------
    kernel : {"conditional", "smoothing"}
        How trajectories are drawn. ``conditional`` gives the exact posterior with any number of particles: calibrate
        physics with it and few particles. ``smoothing`` is the paper's: at finite n its target knows the error of a
        filter with n particles; tune a deployed filter of n particles with it, at that n.
    particles : int, optional
        Particles n; 25 for conditional and 500 for smoothing when left out.
    metropolis_steps : int
        Rounds of one-dimensional updates of theta per trajectory update (the paper's m;
        analyses/effect_of_m_and_r: above 10 no gain).
    transport_moves : int, optional
        Transport moves of theta and path together in each sweep. When left out, conditional makes 3 to 6, as tuning
        finds best, and smoothing none: they carry the exact posterior's path, and the paper's sampler has none.
    data_rate : int, optional
        Rows of the log that each sweep of burn-in includes (the paper's r); a 25th of the longest log when left
        out.
    burn_in_particles : int
        Particles while data is being included: many, because a robot that is lost then stays lost.
    settling_sweeps : int
        Sweeps with all data before tuning.
    tuning_sweeps : tuple of int
        Sweeps of each round of tuning.
    sweeps_per_draw : int, optional
        Sweeps from one stored draw to the next; when left out one or two, by the autocorrelation that tuning measures.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006.
    Andrieu, Doucet, Holenstein, Particle Markov chain Monte Carlo methods, JRSS B 72, 2010.
    """

    name: ClassVar[str] = "particle-gibbs"
    description: ClassVar[str] = "the paper's sampler, with conditional SMC and transport moves"
    variants: ClassVar[Mapping[str, Variant]] = {
        "particle-gibbs": Variant(_EVERY_SWEEP, description),
        "conditional": Variant(_EVERY_SWEEP, description),
        "plain": Variant({**_EVERY_SWEEP, "transport_moves": 0}, "the same without transport moves"),
        "smoothing": Variant(
            {**_EVERY_SWEEP, "kernel": "smoothing"},
            "the paper's sampler: particle smoothing, and Metropolis updates one parameter at a time",
        ),
    }

    kernel: Literal["conditional", "smoothing"] = setting(
        "conditional",
        "conditional: the exact posterior, to know the robot's noise. smoothing: the paper's kernel, to tune a filter "
        "that runs with as many particles.",
        choices=("conditional", "smoothing"),
    )
    particles: int | None = setting(
        None,
        "Particles of the filter.",
        least=2,
        otherwise=_by_kernel(_PARTICLES),
        advice="25 to 1000 are usual",
    )
    metropolis_steps: int = setting(5, "Updates of theta for each trajectory (the paper's m).", least=1)
    transport_moves: int | None = setting(
        None,
        "Moves of theta and path together in each sweep, which make the chains mix; 0 leaves them out.",
        least=0,
        otherwise="3 to 6 for conditional, as tuning finds best, and 0 for smoothing",
    )
    data_rate: int | None = setting(
        None,
        "Rows that each sweep of burn-in includes (the paper's r).",
        least=1,
        otherwise=f"the rows of the log divided by {_INCLUSION_SWEEPS}",
        advice="leave it out for a 25th of the log",
    )
    burn_in_particles: int = setting(
        1000, "Particles during burn-in, while rows are being included.", least=2, advice="25 to 1000 are usual"
    )
    settling_sweeps: int = setting(4, "Sweeps of burn-in with all rows before tuning.", least=1)
    tuning_sweeps: tuple[int, ...] = setting((30, 60, 160), "Sweeps of each round of tuning.", kind=tuple, least=1)
    sweeps_per_draw: int | None = setting(
        None,
        "Sweeps from one stored draw to the next.",
        least=1,
        otherwise="one or two, by the autocorrelation that tuning measures",
    )

    @property
    def usual_particles(self) -> int:
        """Number of particles, that of the kernel when none was given."""
        return self.particles if self.particles is not None else _PARTICLES[self.kernel]

    def resolved(self, bound: BoundModel, options: RunOptions) -> Self:
        """Return the method with the numbers that depend on kernel and logs."""
        moves, rate = self.transport_moves, self.data_rate
        return replace(
            self,
            particles=self.usual_particles,
            transport_moves=0 if moves is None and self.kernel == "smoothing" else moves,
            data_rate=rate if rate is not None else math.ceil(max(bound.lengths) / _INCLUSION_SWEEPS),
        )

    def shortest(self) -> Self:
        """Return a run of a few sweeps with few particles, which has every stage."""
        return replace(
            self, particles=10, burn_in_particles=10, data_rate=10**9, settling_sweeps=2, tuning_sweeps=(4, 4)
        )

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the chains, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.particle_gibbs import run_particle_gibbs

        method = self.resolved(bound, options)
        return run_particle_gibbs(bound, method.stages(max(bound.lengths), options), options, method.record(options))

    def stages(self, longest: int, options: RunOptions) -> list[Stage]:
        """Return the stages of a run.

        Parameters
        ----------
        longest : int
            Rows of the longest log.
        options : RunOptions
            Its draws and trajectories count.

        Returns
        -------
        list of Stage
            Inclusion of the data, rounds of tuning, and the draws. All numbers must be known, see :meth:`resolved`.
        """
        from pmcl.sampling.stages import BURN_IN_SHARE, INCLUSION_SHARE, Stage
        from pmcl.sampling.sweep import SweepSettings

        assert self.particles is not None
        assert self.data_rate is not None
        inclusion = SweepSettings(
            kernel="smoothing",
            particles=self.burn_in_particles,
            metropolis_steps=max(self.metropolis_steps, _INCLUSION_METROPOLIS_STEPS),
            transport_moves=0,
            data_rate=self.data_rate,
            gain=_GAIN,
        )
        drawing = SweepSettings(
            kernel=self.kernel,
            particles=self.particles,
            metropolis_steps=self.metropolis_steps,
            transport_moves=self.transport_moves,
            sweeps=self.sweeps_per_draw,
        )
        tuning = replace(drawing, sweeps=1, gain=_GAIN)
        stages = [
            Stage(
                name="inclusion",
                steps=math.ceil(longest / self.data_rate) + self.settling_sweeps,
                settings=inclusion,
                keep_every=0,
                window=max(1, self.settling_sweeps // 2),
                restart_lost=False,
                time_share=INCLUSION_SHARE,
            )
        ]
        rounds = len(self.tuning_sweeps)
        for number, length in enumerate(self.tuning_sweeps, start=1):
            window = math.ceil(length * (_LAST_WINDOW if number == rounds else 0.5))
            stages.append(
                Stage(
                    name=f"tuning-{number}",
                    steps=length,
                    settings=tuning,
                    keep_every=max(1, window // _FITTED_PATHS) if self.transport_moves != 0 else 0,
                    window=window,
                    restart_lost=number < rounds,
                    time_share=INCLUSION_SHARE + (BURN_IN_SHARE - INCLUSION_SHARE) * number / rounds,
                )
            )
        stages.append(Stage("draws", options.draws, drawing, options.keep_every, window=0, restart_lost=False))
        return stages
