"""What a log can tell about each parameter, in numbers and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["CANNOT_TELL", "Advice", "Identification", "Prediction"]

CANNOT_TELL = 0.7
"""Posterior sd as a share of the prior's above which a log cannot tell a parameter.

At the root of one half the log adds as much information as the prior holds; above it, the posterior is mostly the
prior."""

# A relative standard deviation above which a noise is told as an upper limit instead of a value and its error.
_ROUGH = 0.5


class Advice(NamedTuple):
    """What to drive to learn a parameter.

    Attributes
    ----------
    drive : str
        What to do.
    minutes : float
        For how long.
    std : float
        The parameter's posterior standard deviation afterwards, in its unit.
    share : float
        The same as a share of the prior's, as :attr:`Prediction.share`.
    """

    drive: str
    minutes: float
    std: float
    share: float


@dataclass(frozen=True)
class Prediction:
    """What a log will tell about one parameter.

    Attributes
    ----------
    name, unit, description : str
        As in the model.
    relative : bool
        Whether its standard deviation is told as a share of its mean: for noises.
    mean, std : float
        Predicted posterior mean and standard deviation, in its unit.
    limit : float
        Value that it exceeds with a probability of 5 %.
    prior_mean, prior_std : float
        The prior's.
    share : float
        Posterior standard deviation as a share of the prior's: in the parameter's unit or, for one that has a lower
        bound, in its logarithm, whichever is less.
    advice : Advice or None
        What to drive where the log cannot tell it; None where it can, or where no drive that was tried helps.
    tried : bool
        Whether drives were tried.
    """

    name: str
    unit: str
    description: str
    relative: bool
    mean: float
    std: float
    limit: float
    prior_mean: float
    prior_std: float
    share: float
    advice: Advice | None = None
    tried: bool = False

    @property
    def can_tell(self) -> bool:
        """Whether the log can tell the parameter."""
        return self.share <= CANNOT_TELL

    @property
    def precision(self) -> str:
        """How well the log tells the parameter, such as ``to 12 %`` or ``only that it is below 0.02 m``."""
        if not self.can_tell:
            return "this log cannot tell"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if not self.relative:
            return f"to ± {self.std:.2g}{unit}"
        if self.std <= _ROUGH * self.mean:
            return f"to {100.0 * self.std / self.mean:.2g} %"
        return f"only that it is below {self.limit:.2g}{unit}"

    @property
    def sentence(self) -> str:
        """The same with the parameter's name, and what to drive."""
        return f"{self.name}: {self.precision}{self.remedy}"

    @property
    def remedy(self) -> str:
        """What to drive, as the end of the sentence; empty where the log can tell the parameter."""
        if self.can_tell or not self.tried:
            return ""
        if self.advice is None:
            return "; no drive that was tried tells it within ten minutes: fix it, or give it a narrower prior"
        minutes = "a minute" if self.advice.minutes == 1.0 else f"{self.advice.minutes:g} minutes"
        return f"; {self.advice.drive} for {minutes}, and it is known {self._after()}"

    def _after(self) -> str:
        assert self.advice is not None
        if self.relative and self.advice.std <= _ROUGH * self.mean:
            return f"to {100.0 * self.advice.std / self.mean:.2g} %"
        return f"to ± {self.advice.std:.2g}{'' if self.unit == '1' else f' {self.unit}'}"


@dataclass(frozen=True)
class Identification:
    """What a log can tell about the parameters of a model.

    Attributes
    ----------
    where, robot : str
        The log.
    rows, readings : int
        Its length.
    duration : float
        Its length [s].
    predictions : tuple of Prediction
        In the order of the model's parameters.
    drives : mapping of str to tuple of float
        For each drive that was tried: posterior standard deviation of each parameter as a share of the prior's
        (:attr:`Prediction.share`) after a minute of it, besides this log.
    correlations : tuple of (str, str, float)
        Pairs of parameters whose predicted posterior correlation is strong, the strongest first.
    effective_draws : float
        Effective number of the weighted draws from which standard deviations are computed; for a model with gross
        errors, of the chain's draws of the parameter that has fewest.
    notes : tuple of str
        What a reader should know about how these numbers came about.
    """

    where: str
    robot: str
    rows: int
    readings: int
    duration: float
    predictions: tuple[Prediction, ...]
    drives: dict[str, tuple[float, ...]]
    correlations: tuple[tuple[str, str, float], ...]
    effective_draws: float
    notes: tuple[str, ...] = ()

    @property
    def untold(self) -> tuple[Prediction, ...]:
        """The parameters that the log cannot tell."""
        return tuple(prediction for prediction in self.predictions if not prediction.can_tell)

    @property
    def sentence(self) -> str:
        """One sentence for the whole log."""
        n = len(self.predictions)
        untold = [prediction.name for prediction in self.untold]
        if not untold:
            return f"This log can tell {'the one parameter' if n == 1 else f'all {n} parameters'} of the model"
        told = n - len(untold)
        named = ", ".join(untold)
        if told == 0:
            return f"This log can tell no parameter of the model; it leaves {named} as uncertain as the prior"
        return f"This log can tell {told} of {n} parameters; it cannot tell {named}"

    @property
    def worst(self) -> float:
        """The greatest share of a prior's standard deviation that stays."""
        return max((prediction.share for prediction in self.predictions), default=math.nan)
