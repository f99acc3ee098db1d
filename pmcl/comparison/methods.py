"""The methods that can be compared, and how they are written: ``conditional:25``, a name and a number of particles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pmcl.checks import check_choice, check_type, check_whole
from pmcl.errors import SamplingError, did_you_mean
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.chains import Chains
from pmcl.sampling.run import run_ensemble, run_particle_gibbs
from pmcl.sampling.stages import Plan
from pmcl.sampling.stopwatch import Stopwatch

__all__ = ["METHODS", "Method", "draw", "parse_methods"]

# Only the clock ends a run, but a plan has a number of draws: more than any time allows.
_MOST_DRAWS = 1_000_000_000
_ENSEMBLE_BURN_IN = 100

METHODS: dict[str, tuple[int, str]] = {
    "conditional": (25, "particle Gibbs: conditional SMC with backward sampling, and transport moves"),
    "plain": (25, "the same without transport moves"),
    "smoothing": (500, "the paper's sampler: particle smoothing, and Metropolis updates one parameter at a time"),
    "ensemble": (200, "emcee's stretch move on the pseudo-marginal target"),
}
"""Name to usual number of particles and what it is."""

_OTHER_NAMES = {"particle-gibbs": "conditional"}


@dataclass(frozen=True)
class Method:
    """One way to draw from the posterior.

    Attributes
    ----------
    name : str
        A key of :data:`METHODS`.
    particles : int
        Number of particles n.
    """

    name: str
    particles: int

    def __post_init__(self) -> None:
        """Check the values; raises SamplingError."""
        check_choice("the name of a method", self.name, tuple(METHODS), error=SamplingError)
        check_whole("particles of a method", self.particles, 2, error=SamplingError, advice="25 to 1000 are usual")

    def __str__(self) -> str:
        return f"{self.name}:{self.particles}"

    @property
    def description(self) -> str:
        """What it does, in a few words."""
        return METHODS[self.name][1]


def parse_methods(text: str) -> tuple[Method, ...]:
    """Read names of methods, separated by commas, each with a number of particles or without.

    Parameters
    ----------
    text : str
        Such as ``conditional:25,smoothing:500,ensemble``; ``particle-gibbs`` is another name of ``conditional``.

    Returns
    -------
    tuple of Method

    Raises
    ------
    SamplingError
        For a name that is not known, a number that cannot be one of particles, a method given twice, or none.
    """
    methods: list[Method] = []
    for item in (part.strip() for part in text.split(",")):
        given, colon, number = item.partition(":")
        name = _OTHER_NAMES.get(given, given)
        if name not in METHODS:
            raise SamplingError(
                f"expected methods out of {', '.join((*METHODS, *_OTHER_NAMES))}, but got '{item}'{_hint(given)}"
            )
        if colon and not (number.isdecimal() and int(number) >= 2):
            raise SamplingError(
                f"expected a number of particles of at least 2 after '{given}:', but got '{number}'; "
                f"write for example {given}:{METHODS[name][0]}"
            )
        method = Method(name, int(number) if colon else METHODS[name][0])
        if method in methods:
            raise SamplingError(f"expected each method once, but got {method} twice in '{text}'; leave one out")
        methods.append(method)
    return tuple(methods)


def _hint(name: str) -> str:
    return "; " + did_you_mean(name, (*METHODS, *_OTHER_NAMES), "choose one of them, such as conditional:25")


def draw(method: Method, bound: BoundModel, chains: int, seed: int, stopwatch: Stopwatch) -> Chains:
    """Run a method until its time is over.

    Parameters
    ----------
    method : Method
    bound : BoundModel
        The model bound to its logs.
    chains : int
        Number of chains; the ensemble takes as many walkers as it needs, at least 2 d + 2.
    seed : int
    stopwatch : Stopwatch
        Says when to stop, and notes the time of every step. Burn-in takes at most half of the time.

    Returns
    -------
    Chains

    Raises
    ------
    PmclError
        When no chain can start, or the time is over before the first draw.
    """
    if method.name == "ensemble":
        return run_ensemble(
            bound,
            particles=method.particles,
            n_walkers=max(chains, 2 * bound.dimension + 2),
            draws=_MOST_DRAWS,
            burn_in=_ENSEMBLE_BURN_IN,
            seed=seed,
            trajectories=1,
            stopwatch=stopwatch,
        )
    plan = Plan(
        kernel="smoothing" if method.name == "smoothing" else "conditional",
        particles=method.particles,
        transport_moves=Plan.transport_moves if method.name == "conditional" else 0,
        data_rate=math.ceil(max(bound.lengths) / 50),
        draws=_MOST_DRAWS,
        sweeps_per_draw=1,
        trajectories=1,
    )
    return run_particle_gibbs(bound, plan, chains, seed, stopwatch=stopwatch)


def as_methods(methods: str | Sequence[Method]) -> tuple[Method, ...]:
    """Return methods, from text or as they are."""
    if isinstance(methods, str):
        return parse_methods(methods)
    advice = "write for example 'conditional:25,ensemble'"
    check_type("methods", methods, (str, list, tuple), error=SamplingError, advice=advice)
    if not methods:
        raise SamplingError(f"expected at least one method, but got none; {advice}")
    return tuple(check_type("each of methods", one, Method, error=SamplingError, advice=advice) for one in methods)
