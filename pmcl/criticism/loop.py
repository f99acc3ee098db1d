"""The loop of the critic: fit, judge, name, add and refit, until no alarm is left or none can be explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.calibration.particle_gibbs import ParticleGibbs
from pmcl.calibration.workflow import calibrate
from pmcl.criticism.findings.assemble import (
    candidates_of,
    drawn_estimates,
    estimates,
    found_effect,
    unexplained_of,
    with_estimates_of,
    with_window,
)
from pmcl.criticism.findings.parts import FoundEffect, Step
from pmcl.criticism.findings.result import Criticism, JudgedFit
from pmcl.criticism.findings.verdict import sentence_of, verdict_of, with_place
from pmcl.criticism.fitting.following import particles_that_follow
from pmcl.criticism.fitting.held_out import bound_to_other, gap_of
from pmcl.criticism.fitting.quick_fit import LONG, Fit, quick_fit
from pmcl.criticism.fitting.trials import Trial, spare_effects
from pmcl.criticism.fitting.when import Acting, acting
from pmcl.criticism.judging.judged_log import in_doubt
from pmcl.criticism.naming.choice import twins_of
from pmcl.criticism.naming.lost_robot import Recovery
from pmcl.criticism.naming.probability import (
    Explanations,
    explanations,
    nothing_without_refits,
    with_probabilities,
)
from pmcl.criticism.naming.search import FIT_SHARE, LATE_FIT_SHARE, Outcome, Search
from pmcl.criticism.settings import FINER, Settings
from pmcl.errors import FilterError
from pmcl.filtering.ahead import compile_for_criticism
from pmcl.filtering.estimated_path import with_estimates
from pmcl.filtering.one_step_ahead import Predictions, predict_by_passes
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import path_formulas, portable
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.compat import Posterior
from pmcl.streams import stream, stream_seed

__all__ = ["Loop"]

Float = NDArray[np.float64]

# Parameters of effects cost a density of the whole log for each proposal, and transport moves change them as well.
_METROPOLIS_STEPS = 2


class _Searched(NamedTuple):
    """The result of a search, and the current model that its trials are compared with."""

    outcome: Outcome
    current: Trial


class Loop:
    """The state of one run.

    Parameters
    ----------
    model : RobotModel
        The base model.
    search : Search
        Searches through the candidates for the log.

    Attributes
    ----------
    notes : list of str
        Limits of the result.
    steps : list of Step
        The models so far.
    found : list of FoundEffect
        Accepted effects that the current model has.
    predictions : list of (Predictions, ndarray)
        Predictions of each step's model with their PITs, from which the gaps are computed at the end.
    nothing_probability : float
        Posterior probability that the base model lacks nothing; NaN where its filter loses the robot.
    """

    def __init__(self, model: RobotModel, search: Search) -> None:
        self.base, self.search, self.log = model, search, search.log
        self.notes: list[str] = []
        self.steps: list[Step] = []
        self.found: list[FoundEffect] = []
        self.predictions: list[tuple[Predictions, Float]] = []
        self.nothing_probability = np.nan
        if search.held_out is not None:
            self.notes.append(
                f"models are fitted to the whole of {self.log.where}; gains are confirmed and gaps shown on "
                f"{search.held_out.where}, which no fit has used"
            )

    @property
    def settings(self) -> Settings:
        """Settings of the run; the number of particles may have grown."""
        return self.search.settings

    @property
    def _held_out_rows(self) -> slice:
        """The rows of the held-out part among those that are predicted for the gaps."""
        return slice(self.search.split if self.search.held_out is None else 0, None)

    def run(self, rounds: int, joint: bool, draws: int, always: bool) -> Criticism:
        """Run the loop.

        Parameters
        ----------
        rounds : int
            Greatest number of effects that are added.
        joint : bool
            Whether the final model is calibrated by full chains if an effect was added.
        draws : int
            Draws of each full chain.
        always : bool
            Whether full chains are run even if no effect was added.
        """
        self.settings.tell("fitting the base model")
        bound = self.base.bind(self.log)
        compile_for_criticism(bound.tables(bound.prior_mean())[0])
        fit = quick_fit(bound, stream_seed(self.settings.seed, "fit of the whole log", 0))
        recovery = self._recovery(fit)
        first = last = self.search.judge(fit)
        self._note_single_channel(last)
        current: Trial | None = None
        if recovery is not None:
            current = self._add_recovery(last, recovery)
            last = self._refit(last, current, rounds)
        else:
            self.nothing_probability = nothing_without_refits(first.judgement, self.search.directions)
        for number in range(int(recovery is not None), rounds + 1):
            if in_doubt(last.judgement) and (self.found or number == rounds):
                last = self.search.judge_again(last)
                first = first if self.found else last
            alarms = last.judgement.raised
            shown = self.search.effect_shown_by_data(last) if number < rounds else None
            if shown is not None:
                self.nothing_probability = self.nothing_probability if self.found else 0.0
                current = self._accept(last, shown, "add {}: the data show it")
                last = self._refit(last, current, number)
                continue
            if not alarms or number == rounds:
                decision = f"stop after {rounds} effects" if alarms else "nothing unusual"
                self._record(last, current or self.search.trial_of(last), [], decision)
                break
            worst = f"{alarms[0].family} ({alarms[0].worst.kind}), p = {alarms[0].p_value:.1e}"
            self.settings.tell(f"alarm: {worst}", "looking for what explains the alarm")
            current = current or self.search.trial_of(last)
            # Beside an accepted effect an alarm in doubt was judged again above.
            doubted = not self.found and in_doubt(last.judgement)
            outcome, compared = self._search(last, current, thorough=not doubted)
            if doubted and not outcome.certain:
                first = last = self.search.judge_again(last)
                if not last.judgement.raised:
                    self._explanations(last, compared, outcome)
                    self._record(last, current, outcome.trials, "nothing unusual")
                    break
                outcome, compared = self._search(last, current)
            current = compared
            probable = self._explanations(last, current, outcome)
            if outcome.accepted is None or outcome.found is None:
                self._record(last, current, outcome.trials, "nothing known explains it")
                break
            outcome = outcome._replace(found=with_probabilities(outcome.found, outcome.accepted, probable))
            current = self._accept(last, outcome, "add {}", before=current)
            last = self._refit(last, current, number)
        return self._result(first, last, draws, chains=joint and (bool(self.found) or always))

    def _recovery(self, fit: Fit) -> Recovery | None:
        """Return None if the filter follows the robot, else an effect with which it does.

        Raises FilterError when there is none.
        """
        try:
            self._follow(fit)
        except FilterError as lost:
            recovery = self.search.recover(fit, partial(self._follow, patient=True))
            if recovery is None:
                raise
            when = str(lost).partition(" at ")[2].partition(";")[0]
            name = recovery.accepted.model.effects[-1].name
            self.notes.append(f"without {name} the filter loses the robot at {when}")
            self.settings.tell(f"named {name}: with it the filter follows", "fitting the model with it")
            return recovery
        return None

    def _add_recovery(self, last: JudgedFit, recovery: Recovery) -> Trial:
        trial, trials = recovery
        self.found.append(found_effect(trial, twins_of(trial, trials), last.judgement, self.search.directions))
        return self._added(last, trial, trials, f"add {trial.model.effects[-1].name}: with it the filter follows")

    def _note_single_channel(self, judged: JudgedFit) -> None:
        predictions = judged.scored.predictions
        channels = set(zip(predictions.kind.tolist(), predictions.channel.tolist(), strict=True))
        if len(channels) < 2:
            self.notes.append("one channel only: its own errors cannot be told from those of the path")

    def _search(self, last: JudgedFit, current: Trial, thorough: bool = True) -> _Searched:
        """Look for what explains the alarms of a model, in the catalogue and among formulas.

        Parameters
        ----------
        last : JudgedFit
            The model fitted to the whole log.
        current : Trial
            The same model fitted on the fit part.
        thorough : bool
            Whether to go on if the candidates with the greatest scores do not explain the alarms.
        """
        outcome = self.search.explain(last, current, thorough)
        if thorough and outcome.accepted is None and self.search.comes_late(last):
            self.search.split_at(LATE_FIT_SHARE)
            late = self.search.trial_of(last)
            again = self.search.explain(last, late)
            if again.accepted is not None:
                return _Searched(again, late)
            self.search.split_at(FIT_SHARE)
            formula = self.search.explain_by_formula(last, current)
            outcome = formula._replace(trials=outcome.trials + formula.trials)
        return _Searched(outcome, current)

    def _explanations(self, last: JudgedFit, current: Trial, outcome: Outcome) -> Explanations:
        """Return the probabilities of what may explain the alarms of a model; those of the base model are kept."""
        search = self.search
        probable = explanations(
            current, outcome.trials, search.directions, search.n_formulas, last.judgement.p_value,
            stream_seed(self.settings.seed, "noise of evidences"),
        )  # fmt: skip
        if not self.found:
            self.nothing_probability = probable.nothing
        return probable

    def _follow(self, fit: Fit, patient: bool = False) -> None:
        """Use as many particles as follow the robot from now on; raise FilterError if none do."""
        particles, note = particles_that_follow(
            fit.bound, fit.theta, self.settings.particles, stream_seed(self.settings.seed, "guard"), patient=patient
        )
        if note:
            self.notes.append(note)
            # Comparisons take most of the time then, and are less noisy than those with fewer particles.
            finer = FINER if particles < 4 * self.settings.particles else FINER // 2
            self.search.use_particles(particles, finer)

    def _accept(self, last: JudgedFit, outcome: Outcome, decision: str, before: Trial | None = None) -> Trial:
        """Add the effect that a search accepted; return the model with it."""
        accepted, found = outcome.accepted, outcome.found
        assert accepted is not None
        assert accepted.effect is not None
        assert found is not None
        self.found.append(found)
        return self._added(last, accepted, outcome.trials, decision.format(accepted.effect.name), before)

    def _added(
        self, last: JudgedFit, accepted: Trial, trials: list[Trial], decision: str, before: Trial | None = None
    ) -> Trial:
        """Record a step that adds an effect; return the model with it."""
        assert accepted.effect is not None
        self._record(last, before or self.search.trial_of(last), trials, decision, accepted)
        gain = accepted.on_heldout.total
        self.settings.tell(
            f"added {with_place(accepted.effect)}: {gain:+.1f} nats on held-out data", "fitting the model with it"
        )
        return self._without_spare(accepted)

    def _refit(self, last: JudgedFit, current: Trial, number: int) -> JudgedFit:
        """Fit the new model to the whole log, and judge it."""
        seed = stream_seed(self.settings.seed, "fit of the whole log", number + 1)
        bound = current.model.bind(self.log)
        fit = current.fit
        return self.search.judge(quick_fit(bound, seed, theta=fit.theta, path=last.fit.path, draws=fit.draws))

    def _without_spare(self, accepted: Trial) -> Trial:
        """Remove earlier effects that the newest one makes unnecessary."""
        n_base = len(self.base.effects)
        refits = self.search.refits
        trial, dropped = spare_effects(
            refits.comparable(accepted), n_base, refits.logs, self.search.split, seed=refits.seed,
            particles=self.settings.comparing,
        )  # fmt: skip
        for position in dropped:
            removed = self.found.pop(position - n_base)
            self.notes.append(f"{removed.name} was added first and dropped when a later effect explained it")
        return trial

    def _record(
        self,
        last: JudgedFit,
        current: Trial,
        trials: Sequence[Trial],
        decision: str,
        accepted: Trial | None = None,
    ) -> None:
        """Append the current model to the steps.

        Parameters
        ----------
        last : JudgedFit
            The model fitted to the whole log.
        current : Trial
            The same model fitted on the fit part.
        trials : sequence of Trial
            Refitted candidates.
        decision : str
            The decision about the model.
        accepted : Trial, optional
            The trial that is added to the model.
        """
        held_out = self.search.held_out
        bound = current.model.bind(self.log) if held_out is None else bound_to_other(current.model, held_out)
        rng = make_rng(stream(self.settings.seed, "predictions of a step"))
        predictions = predict_by_passes(
            bound.tables(current.fit.theta)[0], bound.lengths[0], self.settings.comparing, rng
        )
        pit = predictions.pit(rng)
        self.predictions.append((predictions, pit))
        gap = gap_of(predictions, pit, self._held_out_rows)
        names = tuple(effect.name for effect in bound.model.effects)
        listed = candidates_of(last.judgement, self.search.directions, trials, accepted)
        self.steps.append(Step(names, gap, last.judgement.alarms, listed, decision, last.judgement.critical_z))

    def _windows(self, fit: Fit, added: Sequence[Effect]) -> list[Acting | None]:
        """Return when each added effect acts, given a fit of the final model to the whole log."""
        if added:
            self.settings.tell("looking for when each effect acts")
        seed = stream_seed(self.settings.seed, "windows of effects")

        def find(k: int) -> Acting | None:
            return acting(fit, added[k], particles=self.settings.particles, seed=seed)

        return self.settings.mapped(find, "windows of effects", [effect.name for effect in added])

    def _calibrated(self, model: RobotModel, draws: int) -> Posterior:
        """Run full chains of the final model."""
        self.settings.tell("calibrating the final model by full chains")
        reporter = self.settings.reporter
        with reporter.paused():
            return calibrate(
                self.log, model, draws=draws, method=ParticleGibbs(metropolis_steps=_METROPOLIS_STEPS),
                seed=self.settings.seed, progress=reporter.live,
            )  # fmt: skip

    def _result(self, first: JudgedFit, last: JudgedFit, draws: int, chains: bool) -> Criticism:
        """Return the result; `chains` tells whether full chains of the final model are run."""
        # The held-out part may have become shorter during the run; all gaps are those of the last one.
        self.steps = [
            replace(step, gap=gap_of(predictions, pit, self._held_out_rows))
            for step, (predictions, pit) in zip(self.steps, self.predictions, strict=True)
        ]
        before, after, posterior = estimates(first.fit), estimates(last.fit), None
        model = last.fit.bound.model
        if chains:
            posterior = self._calibrated(model, draws)
            after = drawn_estimates(last.fit, posterior)
        elif self.found:
            after = estimates(
                quick_fit(
                    last.fit.bound, stream_seed(self.settings.seed, "long fit"), theta=last.fit.theta,
                    path=last.fit.path, draws=last.fit.draws, effort=LONG,
                )
            )  # fmt: skip
        added = model.named_effects[len(self.base.effects) :]
        windows = self._windows(last.fit, added)
        found = tuple(
            with_window(with_estimates_of(found, effect, after, model.fixed), effect, window)
            for found, effect, window in zip(self.found, added, windows, strict=True)
        )
        unexplained = unexplained_of(last, self.search.directions)
        verdict = verdict_of(found, last.judgement)
        settings: dict[str, Any] = vars(self.settings) | {"split": self.search.split, "log": self.log.fingerprint()}
        settings["statistics"] = [statistic.name for statistic in self.settings.statistics]
        if self.search.held_out is not None:
            settings["held_out"] = self.search.held_out.fingerprint()
        del settings["workers"], settings["reporter"]  # the result does not depend on them
        # The model that is handed over applies to other logs as well: its formulas are evaluated anew on each.
        model = replace(model, effects=tuple(portable(effect) for effect in model.effects))
        log = with_estimates(self.log, last.fit.tables, last.fit.path) if path_formulas(model.effects) else self.log
        return Criticism(
            verdict=verdict,
            sentence=sentence_of(verdict, found, unexplained, self.steps, before, after, self.log),
            effects=found,
            unexplained=unexplained,
            steps=tuple(self.steps),
            base=self.base,
            model=model,
            before=before,
            after=after,
            log=log,
            split=self.search.split,
            held_out=self.search.held_out,
            first=first,
            last=last,
            posterior=posterior,
            notes=tuple(self.notes),
            settings=settings,
            nothing_probability=self.nothing_probability,
        )
