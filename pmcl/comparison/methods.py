"""The methods that are compared, and how they are written: ``conditional:25``, a name and a number of particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from pmcl.calibration.method import CalibrationMethod, Variant
from pmcl.calibration.methods import method_class, method_names
from pmcl.checks import check_type
from pmcl.errors import SamplingError, did_you_mean
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.chains import Chains, PointEstimate
from pmcl.sampling.options import RunOptions
from pmcl.sampling.stopwatch import Stopwatch

__all__ = ["ComparedMethod", "as_methods", "comparable_names", "draw", "parse_methods"]

# Only the clock ends a run, but a run has a number of draws: more than any time allows.
_MOST_DRAWS = 1_000_000_000


@dataclass(frozen=True)
class ComparedMethod:
    """A calibration method, and the name by which a comparison shows it.

    Attributes
    ----------
    name : str
        The name.
    method : CalibrationMethod
        The method with its settings.
    description : str
        What it does, in a few words.
    """

    name: str
    method: CalibrationMethod
    description: str

    def __str__(self) -> str:
        particles = self.method.usual_particles
        return self.name if particles is None else f"{self.name}:{particles}"


def comparable_names() -> dict[str, tuple[type[CalibrationMethod], Variant]]:
    """Return the names that a comparison knows: those of all registered methods and of their variants.

    Returns
    -------
    dict of str to (type, Variant)
        The class of the method, and the settings that the name stands for.
    """
    names: dict[str, tuple[type[CalibrationMethod], Variant]] = {}
    for name in method_names():
        found = method_class(name)
        variants: Mapping[str, Variant] = {name: Variant({}, found.description), **found.variants}
        names |= {each: (found, variant) for each, variant in variants.items()}
    return names


def parse_methods(text: str) -> tuple[ComparedMethod, ...]:
    """Read names of methods, separated by commas, each with a number of particles or without.

    Parameters
    ----------
    text : str
        Such as ``conditional:25,smoothing:500,ensemble``; ``particle-gibbs`` is another name of ``conditional``.

    Returns
    -------
    tuple of ComparedMethod

    Raises
    ------
    SamplingError
        For a name that is not known, a number that cannot be one of particles, a method given twice, or none.
    """
    known = comparable_names()
    methods: list[ComparedMethod] = []
    for item in (part.strip() for part in text.split(",")):
        name, colon, number = item.partition(":")
        if name not in known:
            hint = did_you_mean(name, known, "choose one of them, such as conditional:25")
            raise SamplingError(f"expected methods out of {', '.join(known)}, but got '{item}'; {hint}")
        found, variant = known[name]
        settings = dict(variant.settings)
        if colon:
            settings["particles"] = _particles(name, number, found)
        # The usual number is written out, so that a method given with it and without it is the same.
        elif found(**settings).usual_particles is not None:
            settings["particles"] = found(**settings).usual_particles
        method = ComparedMethod(name, found(**settings), variant.description)
        for other in methods:
            if other.method == method.method:
                raise SamplingError(
                    f"expected each method once, but {other} and {method} in '{text}' are the same; leave one out"
                )
        methods.append(method)
    return tuple(methods)


def _particles(name: str, number: str, method: type[CalibrationMethod]) -> int:
    """Return the number of particles that stands behind the name of a method."""
    if "particles" not in {field.name for field in fields(method)}:
        raise SamplingError(f"expected {name} without a number of particles, but got '{name}:{number}'; leave it out")
    if not (number.isdecimal() and int(number) >= 2):
        raise SamplingError(
            f"expected a number of particles of at least 2 after '{name}:', but got '{number}'; "
            f"write for example {name}:{comparable_names()[name][0]().usual_particles or 25}"
        )
    return int(number)


def as_methods(methods: str | Sequence[Any]) -> tuple[ComparedMethod, ...]:
    """Return compared methods, from text, from calibration methods or as they are.

    Parameters
    ----------
    methods : str or sequence of ComparedMethod or CalibrationMethod
        Text is read by :func:`parse_methods`.

    Returns
    -------
    tuple of ComparedMethod

    Raises
    ------
    SamplingError
        When there is none, or something else among them.
    """
    if isinstance(methods, str):
        return parse_methods(methods)
    advice = "write for example 'conditional:25,ensemble'"
    check_type("methods", methods, (str, list, tuple), error=SamplingError, advice=advice)
    if not methods:
        raise SamplingError(f"expected at least one method, but got none; {advice}")
    compared = []
    for given in methods:
        if isinstance(given, CalibrationMethod):
            given = ComparedMethod(given.name, given, given.description)
        compared.append(check_type("each of methods", given, ComparedMethod, error=SamplingError, advice=advice))
    return tuple(compared)


def draw(
    compared: ComparedMethod, bound: BoundModel, chains: int, seed: int, stopwatch: Stopwatch
) -> Chains | PointEstimate:
    """Run a method until its time is over.

    Parameters
    ----------
    compared : ComparedMethod
        The method.
    bound : BoundModel
        The model bound to its logs.
    chains : int
        Number of chains; the ensemble takes as many walkers as it needs, at least 2 d + 2.
    seed : int
        All randomness follows from it.
    stopwatch : Stopwatch
        Says when to stop, and notes the time of every step. Burn-in takes at most half of the time.

    Returns
    -------
    Chains or PointEstimate

    Raises
    ------
    PmclError
        When no chain can start, or the time is over before the first draw.
    """
    options = RunOptions(draws=_MOST_DRAWS, chains=chains, seed=seed, trajectories=1, stopwatch=stopwatch)
    return compared.method.run(bound, options)
