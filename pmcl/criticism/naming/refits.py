"""Candidates refitted to the log, first at a glance, then at greater length where this may matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from pmcl.criticism.findings.verdict import with_place
from pmcl.criticism.fitting.quick_fit import GLANCE, Effort, Fit
from pmcl.criticism.fitting.trials import Trial, refitted, trial_of_base, try_effect
from pmcl.criticism.naming.candidates import RankedEffect
from pmcl.criticism.scoring.scores import instance_key
from pmcl.criticism.settings import Settings
from pmcl.logs.robot_log import RobotLog
from pmcl.streams import stream_seed

__all__ = ["Refits"]


class Refits:
    """Refits candidates, and remembers what was refitted since the last judgement of the log.

    Attributes
    ----------
    log : RobotLog
        The log.
    settings : Settings
        Settings of the run; the number of particles may have grown.
    """

    def __init__(self, log: RobotLog, settings: Settings) -> None:
        self.log, self.settings = log, settings
        self._known: dict[Any, Trial] = {}

    @property
    def seed(self) -> int:
        """Seed of all refits."""
        return stream_seed(self.settings.seed, "refits")

    def forget(self) -> None:
        """Forget all trials, because they belong to another current model."""
        self._known = {}

    def base_trial(self, fit: Fit) -> Trial:
        """Score a fitted model, with which candidates are compared."""
        return trial_of_base(fit, seed=self.seed)

    def glances(self, current: Trial, chosen: Sequence[RankedEffect]) -> list[Trial]:
        """Fit candidates at a glance; one that was fitted before is not fitted again.

        Parameters
        ----------
        current : Trial
            The current model.
        chosen : sequence of RankedEffect
            The candidates.

        Returns
        -------
        list of Trial
            In the order of the candidates; one that cannot be fitted is left out.
        """
        new = [one for one in chosen if instance_key(one.effect) not in self._known]
        names = [with_place(one.effect) for one in new]
        if new:
            self.settings.tell("refitting " + ", ".join(names))

        def glance_at(k: int) -> Trial | None:
            return try_effect(
                current, new[k].effect, new[k].z, self.log, seed=self.seed, effort=GLANCE, at=new[k].starts_at
            )  # fmt: skip

        for trial in self.settings.mapped(glance_at, "quick fits of candidates", names):
            if trial is not None:
                self._remember(trial)
        trials = [(one, self._known.get(instance_key(one.effect))) for one in chosen]
        return [replace(trial, effect=one.effect, z=one.z) for one, trial in trials if trial is not None]

    def longer(self, current: Trial, trials: Sequence[Trial], effort: Effort) -> list[Trial]:
        """Continue the fits of trials.

        Parameters
        ----------
        current : Trial
            The current model.
        trials : sequence of Trial
            The trials.
        effort : Effort
            Length of the further fit.

        Returns
        -------
        list of Trial
            In the same order.
        """

        def fit(k: int) -> Trial:
            return refitted(trials[k], current, seed=self.seed, effort=effort)

        longer = self.settings.mapped(fit, "longer fits of candidates", _names_of(trials))
        for trial in longer:
            self._remember(trial)
        return longer

    def _remember(self, trial: Trial) -> None:
        assert trial.effect is not None
        self._known[instance_key(trial.effect)] = trial


def _names_of(trials: Sequence[Trial]) -> list[str]:
    return ["" if trial.effect is None else with_place(trial.effect) for trial in trials]
