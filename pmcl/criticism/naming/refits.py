"""Candidates refitted in three stages: all at a glance, the better ones briefly, the leading ones thoroughly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from pmcl.criticism.findings.verdict import with_place
from pmcl.criticism.fitting.quick_fit import BRIEF, GLANCE, THOROUGH, Effort, Fit
from pmcl.criticism.fitting.trials import Trial, refitted, scored_anew, trial_of_base, try_effect
from pmcl.criticism.naming.choice import choose, contenders, contenders_when_lost, leaders, worth_it
from pmcl.criticism.naming.shortlist import RankedEffect
from pmcl.criticism.scoring.scores import instance_key
from pmcl.criticism.settings import FINER, Settings
from pmcl.logs.robot_log import RobotLog
from pmcl.streams import stream_seed

__all__ = ["Refits"]

# Particles that are enough for a glance (chosen by hand).
_GLANCE_PARTICLES = 2000
# Models that held-out rows do not confirm are compared again with this many times the particles (chosen by hand).
_MORE_PARTICLES = 4


class Refits:
    """Refits candidates, and remembers what was refitted since the last judgement of the log.

    Attributes
    ----------
    log : RobotLog
        The log.
    settings : Settings
        Settings of the run; the numbers of particles may grow.
    split : int
        First row of the held-out part: the number of rows of the log, if another one is held out.
    logs : tuple of RobotLog
        The log, and the one that is held out if there is one.
    """

    def __init__(
        self, log: RobotLog, settings: Settings, split: int, held_out: RobotLog | None = None
    ) -> None:
        self.log, self.settings, self.split = log, settings, split
        self.logs = (log,) if held_out is None else (log, held_out)
        # By effect, number of particles and first row of the held-out part.
        self._known: dict[tuple[Any, int, int], Trial] = {}

    @property
    def seed(self) -> int:
        """Seed of all refits."""
        return stream_seed(self.settings.seed, "refits")

    def forget(self) -> None:
        """Forget all trials, because they belong to another current model."""
        self._known = {}

    def base_trial(self, fit: Fit) -> Trial:
        """Fit the model of a fit of the whole log on the fit part, and score all rows."""
        return trial_of_base(
            fit.bound.model, self.logs, self.split, seed=self.seed, particles=self.settings.comparing,
            theta=fit.theta, path=fit.path, draws=fit.draws,
        )  # fmt: skip

    def comparable(self, current: Trial) -> Trial:
        """Return the current model, its rows scored with as many particles as candidates are."""
        if current.particles == self.settings.comparing:
            return current
        return self._scored_anew(current, current)

    def _scored_anew(self, trial: Trial, current: Trial) -> Trial:
        return scored_anew(
            trial, current, self.logs, self.split, seed=self.seed, particles=self.settings.comparing
        )

    def refit(
        self,
        current: Trial,
        chosen: Sequence[RankedEffect],
        rivals: Sequence[Trial] = (),
        lost: bool = False,
    ) -> list[Trial]:
        """Refit candidates: each at a glance, then those that are not far behind others.

        Parameters
        ----------
        current : Trial
            The current model.
        chosen : sequence of RankedEffect
            The candidates.
        rivals : sequence of Trial
            Other trials that they compete with.
        lost : bool
            Whether the filter of the current model has lost the robot.

        Returns
        -------
        list of Trial
            Candidates refitted before, then the others; a candidate that cannot be fitted is left out.
        """
        current, particles = self.comparable(current), self.settings.comparing
        earlier = [self._known.get((instance_key(candidate.effect), particles, self.split)) for candidate in chosen]
        new = [candidate for candidate, trial in zip(chosen, earlier, strict=True) if trial is None]
        known = [
            replace(trial, effect=candidate.effect, z=candidate.z)
            for candidate, trial in zip(chosen, earlier, strict=True)
            if trial is not None
        ]
        if not new:
            return known
        names = [with_place(candidate.effect) for candidate in new]
        self.settings.tell("refitting " + ", ".join(names))
        rivals = [*rivals, *known]

        def fit(k: int, effort: Effort, particles: int) -> Trial | None:
            effect, z = new[k]
            return try_effect(
                current, effect, z, self.logs, self.split, seed=self.seed, particles=particles, effort=effort
            )

        def glance_at(k: int) -> Trial | None:
            # When a filter needs many particles, its passes take longer than a short fit.
            return fit(k, GLANCE, min(particles, max(_GLANCE_PARTICLES, particles // 2)))

        def fit_briefly(k: int) -> Trial | None:
            glance = glances[k]
            if glance is None:
                return fit(k, BRIEF, particles)
            if not any(glance is trial for trial in going_on):
                return glance
            return refitted(
                glance, current, self.logs, self.split, seed=self.seed, particles=particles, effort=BRIEF
            )

        alone = len(new) + len(rivals) < 2
        glances: list[Trial | None] = [None]
        if not alone:
            glances = self.settings.mapped(glance_at, "quick fits of candidates", names)
        fitted = [glance for glance in glances if glance is not None]
        going_on = contenders_when_lost(fitted, current) if lost else contenders(fitted, rivals)
        brief = self.settings.mapped(fit_briefly, "longer fits of candidates", names)
        trials = [trial for trial in brief if trial is not None]
        self._remember(trials, particles)
        return known + trials

    def refit_thoroughly(self, current: Trial, trials: list[Trial], chosen: Sequence[RankedEffect]) -> list[Trial]:
        """Fit candidates thoroughly, however far behind a glance has found them.

        A short chain leaves in the path and in the noise of the motion what these can absorb: an error of 0.1 m in the
        mount of a recorded robot's laser gained nothing at a glance, where an alpha had taken it up, 17 nats after a
        brief fit, and 24 after a thorough one, in which this alpha had fallen to a twentieth.

        Parameters
        ----------
        current : Trial
            The current model.
        trials : list of Trial
            What was refitted.
        chosen : sequence of RankedEffect
            The candidates, those refitted before among them.

        Returns
        -------
        list of Trial
            All trials; one that was not fitted thoroughly is replaced.
        """
        current, particles = self.comparable(current), self.settings.comparing
        keys = [(instance_key(candidate.effect), particles, self.split) for candidate in chosen]
        new = [
            (candidate, key)
            for candidate, key in zip(chosen, keys, strict=True)
            if key not in self._known or not self._known[key].thorough
        ]
        if not new:
            return trials
        names = [with_place(candidate.effect) for candidate, _ in new]
        self.settings.tell("refitting " + ", ".join(names))

        def fit(k: int) -> Trial | None:
            (effect, z), key = new[k]
            shorter = self._known.get(key)
            if shorter is None:
                return try_effect(
                    current, effect, z, self.logs, self.split, seed=self.seed, particles=particles, effort=THOROUGH
                )
            return refitted(
                replace(shorter, effect=effect, z=z), current, self.logs, self.split, seed=self.seed,
                particles=particles, effort=THOROUGH,
            )  # fmt: skip

        found = self.settings.mapped(fit, "thorough fits of candidates", names)
        longer = [trial for trial in found if trial is not None]
        self._remember(longer, particles)
        again = {self._key(trial, particles) for trial in longer}
        return [trial for trial in trials if self._key(trial, particles) not in again] + longer

    def _key(self, trial: Trial, particles: int) -> tuple[Any, int, int]:
        assert trial.effect is not None
        return instance_key(trial.effect), particles, self.split

    def _remember(self, trials: Sequence[Trial], particles: int) -> None:
        for trial in trials:
            self._known[self._key(trial, particles)] = trial

    def refit_leaders(self, current: Trial, trials: list[Trial], rivals: Sequence[Trial] = ()) -> list[Trial]:
        """Return the trials, after those that lead were fitted thoroughly, if more than one leads.

        Parameters
        ----------
        current : Trial
            The current model.
        trials : list of Trial
            The trials.
        rivals : sequence of Trial
            Other trials that they compete with; they are not refitted.
        """
        leading = leaders([*trials, *rivals])
        if len(leading) < 2:
            return trials
        leading = [trial for trial in leading if not trial.thorough and not any(trial is rival for rival in rivals)]
        current, particles = self.comparable(current), self.settings.comparing

        def fit_thoroughly(k: int) -> Trial:
            return refitted(
                leading[k], current, self.logs, self.split, seed=self.seed, particles=particles, effort=THOROUGH
            )

        thorough = self.settings.mapped(
            fit_thoroughly, "thorough fits of the leading candidates", _names_of(leading)
        )
        self._remember(thorough, particles)
        return _replaced(trials, leading, thorough)

    def with_more_particles(
        self, current: Trial, trials: list[Trial], critical_z: float
    ) -> tuple[Trial, list[Trial]]:
        """Score the leading trials with more particles, if only these confirm the best one.

        The better a model is, the fewer of its particles survive a reading at an edge. A single row may therefore take
        back, by chance, all that a right effect gains. If more particles change the answer, all models are scored with
        them from then on.

        Parameters
        ----------
        current : Trial
            The current model.
        trials : list of Trial
            Refitted candidates.
        critical_z : float
            Critical value of the candidates' scores.

        Returns
        -------
        current : Trial
            The current model, scored with the number of particles that counts.
        trials : list of Trial
            The trials, the leading ones scored with it.
        """
        best, _ = choose(trials)
        if best is None or not best.on_fit.significant or worth_it(best, critical_z):
            return current, trials
        if self.settings.finer > FINER:
            return current, trials
        self.settings.tell("held-out rows do not confirm it: scoring with more particles")
        before = self.settings
        self.settings = replace(before, finer=_MORE_PARTICLES * before.finer)
        same, leading = self.comparable(current), leaders(trials)

        def score(k: int) -> Trial:
            return self._scored_anew(leading[k], same)

        finer = self.settings.mapped(score, "scoring with more particles", _names_of(leading))
        scored = _replaced(trials, leading, finer)
        best, _ = choose(scored)
        if best is not None and worth_it(best, critical_z):
            return same, scored
        self.settings = before
        return current, trials


def _names_of(trials: Sequence[Trial]) -> list[str]:
    return ["" if trial.effect is None else with_place(trial.effect) for trial in trials]


def _replaced(trials: list[Trial], old: list[Trial], new: list[Trial]) -> list[Trial]:
    """Return the trials with each of `old` replaced by the one of `new` at the same position."""
    return [
        next((after for after, before in zip(new, old, strict=True) if before is trial), trial) for trial in trials
    ]
