"""The loop of the critic: fit, judge, name, add and refit, until no alarm is left or none can be explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

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
from pmcl.criticism.findings.parts import FoundEffect, Step, Unexplained
from pmcl.criticism.findings.result import Criticism, JudgedFit
from pmcl.criticism.findings.verdict import UNKNOWN, sentence_of, verdict_of, with_place
from pmcl.criticism.fitting.following import particles_that_follow
from pmcl.criticism.fitting.held_out import HELD_OUT_SHARE, Gap, HeldOut, held_out, predicted_log
from pmcl.criticism.fitting.next_drive import next_drive
from pmcl.criticism.fitting.quick_fit import LONG, Fit, quick_fit
from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.fitting.when import Acting, acting
from pmcl.criticism.judging.judged_log import in_doubt
from pmcl.criticism.naming.gross_errors import without_gross_errors
from pmcl.criticism.naming.lost_robot import Recovery
from pmcl.criticism.naming.probability import log_prior_odds, nothing_without_refits
from pmcl.criticism.naming.revision import Answer, revised
from pmcl.criticism.naming.search import Outcome, Search
from pmcl.criticism.settings import FINER, Settings
from pmcl.errors import FilterError, SamplingError
from pmcl.filtering.ahead import compile_for_criticism
from pmcl.filtering.estimated_path import with_estimates
from pmcl.filtering.paired_scores import Gain, paired_gain
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import path_formulas, portable
from pmcl.models.robot_model import RobotModel
from pmcl.posterior.compat import Posterior
from pmcl.streams import stream_seed

__all__ = ["Loop", "Loss"]

# Parameters of effects cost a density of the whole log for each proposal, and transport moves change them as well.
_METROPOLIS_STEPS = 2


class Loss(NamedTuple):
    """Why not the log as it is and the model that was asked for are criticised: the filter loses the robot.

    Attributes
    ----------
    model : RobotModel
        The model that was asked for.
    what : str
        What is missing by that, for the sentence, e.g. "from t=330.5 s on the filter loses the robot".
    place : Unexplained
        The rows.
    partial : bool
        Whether the log is only a part of the one that was asked for. Otherwise the model has gross errors in addition.
    """

    model: RobotModel
    what: str
    place: Unexplained
    partial: bool = False


class Loop:
    """The state of one run.

    Parameters
    ----------
    model : RobotModel
        The base model.
    search : Search
        Searches through the candidates for the log.
    loss : Loss, optional
        Why these are not the model and the log that were asked for.
    notes : sequence of str
        Notes with which the result begins.
    other : RobotLog, optional
        Another log of the robot, on which gaps are shown instead of on the last part of the log.

    Attributes
    ----------
    notes : list of str
        Limits of the result.
    steps : list of Step
        The models so far.
    answers : list of Answer
        Accepted effects that the current model has.
    split : int
        First row of the held-out part, on which gaps are shown.
    held_out : HeldOut or None
        How the last step's model predicts it.
    nothing_probability : float
        Posterior probability that the base model lacks nothing; NaN where its filter loses the robot.
    """

    def __init__(
        self,
        model: RobotModel,
        search: Search,
        loss: Loss | None = None,
        notes: Sequence[str] = (),
        other: RobotLog | None = None,
    ) -> None:
        self.base, self.search, self.log, self.loss, self.other = model, search, search.log, loss, other
        self.notes = list(notes)
        self.steps: list[Step] = []
        self.answers: list[Answer] = []
        self.split = self.log.n_steps if other is not None else round((1.0 - HELD_OUT_SHARE) * self.log.n_steps)
        self.held_out: HeldOut | None = None
        self.nothing_probability = np.nan
        if other is not None:
            self.notes.append(
                f"models are fitted to {self.log.where}; gains and gaps are shown on {other.where}, which neither a "
                "fit nor the choice of a name has used"
            )

    @property
    def settings(self) -> Settings:
        """Settings of the run; the number of particles may have grown."""
        return self.search.settings

    @property
    def found(self) -> list[FoundEffect]:
        """Accepted effects that the current model has."""
        return [answer.found for answer in self.answers]

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

        Raises
        ------
        FilterError
            When the filter loses the robot and no single effect lets it follow; it tells the row where that is known.
        """
        self.settings.tell("fitting the base model")
        bound = self.base.bind(self.log)
        compile_for_criticism(bound.tables(bound.prior_mean())[0])
        fit = quick_fit(bound, stream_seed(self.settings.seed, "fit of the whole log", 0))
        recovery = self._recovery(fit)
        first = last = self.search.judge(fit)
        self._note_single_channel(last)
        if recovery is not None:
            last = self._add_recovery(last, recovery)
        else:
            self._nothing_is(nothing_without_refits(first.judgement, self.search.directions))
        for number in range(int(recovery is not None), rounds + 1):
            if in_doubt(last.judgement) and (self.found or number == rounds):
                last = self.search.judge_again(last)
                first = first if self.found else last
            alarms = last.judgement.raised
            current = self.search.refits.base_trial(last.fit)
            shown = self.search.effect_shown_by_data(last, current) if number < rounds else None
            if shown is not None:
                self._nothing_is(0.0)
                self._tell_name(shown)
                last = self._accept(last, shown, "add {}: the data show it")
                continue
            suspicion = None if alarms or number == rounds else self.search.explain_suspicion(last, current)
            if suspicion is not None:
                self._nothing_is(suspicion.probable.nothing)
                self._tell_name(suspicion)
                last = self._accept(last, suspicion, "add {}: its evidence is clear, though it raised no alarm")
                continue
            if not alarms or number == rounds:
                self._record(last, [], f"stop after {rounds} effects" if alarms else "nothing unusual")
                break
            worst = f"{alarms[0].family} ({alarms[0].worst.kind}), p = {alarms[0].p_value:.1e}"
            self.settings.tell(f"alarm: {worst}", "looking for what explains the alarm")
            # Beside an accepted effect an alarm in doubt was judged again above.
            doubted = not self.found and in_doubt(last.judgement)
            outcome = self.search.explain(last, current, further=not doubted)
            if doubted and not outcome.certain:
                first = last = self.search.judge_again(last)
                if not last.judgement.raised:
                    self._nothing_is(outcome.probable.nothing)
                    self._record(last, outcome.trials, "nothing unusual")
                    break
                outcome = self.search.explain(last, current)
            self._tell_name(outcome)
            if self.search.refuted(outcome):
                self.settings.tell("that does not explain all of it: trying every other candidate")
                first_answer, outcome = outcome.accepted, self.search.explain(last, current, refuted=outcome)
                if outcome.accepted is not first_answer:
                    self._tell_name(outcome)
            if outcome.accepted is None:
                outcome = self.search.beside_something_unknown(last, current, outcome)
                self._tell_name(outcome)
            self._nothing_is(outcome.probable.nothing)
            if outcome.accepted is None:
                self._record(last, outcome.trials, "nothing known explains it")
                break
            last = self._accept(last, outcome, "add {}")
        if self.loss is not None and self.loss.model.sensors != self.base.sensors:
            last = self._without_gross_errors(self.loss, last)
        return self._result(first, last, draws, chains=joint and (bool(self.found) or always))

    def _recovery(self, fit: Fit) -> Recovery | None:
        """Return None if the filter follows the robot, else an effect with which it does.

        Raises FilterError when there is none.
        """
        try:
            self._follow(fit)
        except FilterError as lost:
            if self.loss is not None:
                raise
            recovery = self.search.recover(fit, partial(self._follow, patient=True))
            if recovery is None:
                raise
            when = f"t={self.log.times[lost.row or 0]:g} s"
            name = recovery.accepted.model.effects[-1].name
            self.notes.append(f"without {name} the filter loses the robot at {when}")
            self.settings.tell(f"named {name}: with it the filter follows", "fitting the model with it")
            return recovery
        return None

    def _add_recovery(self, last: JudgedFit, recovery: Recovery) -> JudgedFit:
        trial, trials = recovery
        found = found_effect(trial, (), last.judgement, self.search.directions)
        return self._added(last, trial, trials, Answer(found), f"add {found.name}: with it the filter follows")

    def _note_single_channel(self, judged: JudgedFit) -> None:
        predictions = judged.scored.predictions
        channels = set(zip(predictions.kind.tolist(), predictions.channel.tolist(), strict=True))
        if len(channels) < 2:
            self.notes.append("one channel only: its own errors cannot be told from those of the path")

    def _nothing_is(self, probability: float) -> None:
        """Set the probability that the base model lacks nothing, as long as it is the base model that is judged."""
        if not self.found and self.loss is None:
            self.nothing_probability = probability

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

    def _tell_name(self, outcome: Outcome) -> None:
        """Tell the user what a search has found, before it takes its time to judge the model with it."""
        if outcome.accepted is not None and outcome.found is not None:
            self.settings.tell(
                f"named {with_place(outcome.found)}: {outcome.accepted.evidence:+.1f} nats of evidence",
                "judging the model with it",
            )

    def _accept(self, last: JudgedFit, outcome: Outcome, decision: str) -> JudgedFit:
        """Add the effect that a search accepted; return the model with it, judged."""
        assert outcome.accepted is not None
        assert outcome.found is not None
        answer = Answer(outcome.found, outcome.credible)
        return self._added(last, outcome.accepted, outcome.trials, answer, decision.format(outcome.found.name))

    def _added(
        self, last: JudgedFit, accepted: Trial, trials: Sequence[Trial], answer: Answer, decision: str
    ) -> JudgedFit:
        """Record a step that adds an effect; return the model with it, judged."""
        assert accepted.effect is not None
        self._record(last, trials, decision, accepted)
        before, found = self.held_out, answer.found
        accepted = self._revised(last, accepted)
        self.held_out = self._predicted(accepted.fit)
        gain = _gain(self.held_out, before)
        if self.other is not None and not gain.total > 0.0:
            self.notes.append(
                f"{found.name} gains nothing on {self.other.where} ({gain.total:.1f} ± {gain.se:.1f} nats): it belongs "
                f"to {self.log.where} alone, or something else is meant"
            )
        self.answers.append(answer._replace(found=self._with_gain(found, gain)))
        self.settings.tell(
            f"added {with_place(found)}: {gain.total:+.1f} nats on held-out data", "judging the model with it"
        )
        return self.search.judge(accepted.fit)

    def _with_gain(self, found: FoundEffect, gain: Gain) -> FoundEffect:
        return replace(
            found, log_score_gain=gain.total, log_score_gain_se=gain.se, chosen_on_all_rows=self.other is None
        )

    def _predicted(self, fit: Fit) -> HeldOut | None:
        """Return how a model predicts the held-out part; None where its filter loses the robot."""
        seed = stream_seed(self.settings.seed, "predictions of a step")
        try:
            if self.other is not None:
                return predicted_log(fit, self.other, particles=self.settings.comparing, seed=seed)
            return held_out(fit, self.split, particles=self.settings.comparing, seed=seed)
        except FilterError:
            return None

    def _revised(self, last: JudgedFit, accepted: Trial) -> Trial:
        """Look at earlier effects again, now that the newest one is in the model."""
        after = revised(
            accepted, self.answers, len(self.base.effects), partial(log_prior_odds, directions=self.search.directions),
            partial(self.search.named_again, last), seed=self.search.refits.seed,
        )  # fmt: skip
        self.answers = after.answers
        for name in after.dropped:
            self.notes.append(f"{name} was added first and dropped when a later effect explained it")
        for position, name, without in after.exchanged:
            answer = self.answers[position]
            self.notes.append(
                f"{name} was added first, and {answer.found.name} took its place, which is more probable in a model "
                "with a later effect"
            )
            self.settings.tell(f"renamed {name}: {with_place(answer.found)}")
            gain = _gain(self._predicted(after.trial.fit), self._predicted(without.fit))
            self.answers[position] = answer._replace(found=self._with_gain(answer.found, gain))
        return after.trial

    def _without_gross_errors(self, loss: Loss, last: JudgedFit) -> JudgedFit:
        """Return the final model without gross errors, fitted and judged, if it needs none; else the model as it is.

        With what was found in it, the filter of the model that was asked for may follow the robot. It then stays if the
        log speaks no more for gross errors than against them.
        """
        if not self.found:
            return last
        without = without_gross_errors(last.fit, loss.model.sensors, self.search.refits, self._follow)
        if without.fit is None:
            self.notes.append(f"gross errors are still needed: {without.reason}")
            return last
        try:
            again = self.search.judge(without.fit)
        except FilterError as error:
            self.notes.append(f"gross errors are kept: {error}")
            return last
        self.notes.append("gross errors were allowed for at first, and dropped when what was found explained them")
        self.held_out = None
        self._record(again, [], "allow for no gross errors: with what was found the filter follows")
        return again

    def _record(self, last: JudgedFit, trials: Sequence[Trial], decision: str, accepted: Trial | None = None) -> None:
        """Append the current model to the steps.

        Parameters
        ----------
        last : JudgedFit
            The model, fitted and judged.
        trials : sequence of Trial
            Refitted candidates.
        decision : str
            The decision about the model.
        accepted : Trial, optional
            The trial that is added to the model.
        """
        if self.held_out is None:
            self.held_out = self._predicted(last.fit)
        gap = self.held_out.gap if self.held_out is not None else Gap(np.nan, np.nan, np.nan)
        names = tuple(effect.name for effect in last.fit.bound.model.effects)
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

    def _with_drive(self, answer: Answer) -> FoundEffect:
        """Return a found effect with the drive that would tell it from its near twins, if it has some."""
        found, credible = answer
        if not found.not_distinguishable_from:
            return found
        self.settings.tell(f"looking for the drive that would tell {found.name} from its near twins")
        seed = stream_seed(self.settings.seed, "what to record next")
        return replace(found, record_next=next_drive(credible, self.log, particles=self.settings.particles, seed=seed))

    def _calibrated(self, model: RobotModel, draws: int) -> Posterior | None:
        """Run full chains of the final model; return None, and note why, if they lose the robot."""
        self.settings.tell("calibrating the final model by full chains")
        reporter = self.settings.reporter
        try:
            with reporter.paused():
                return calibrate(
                    self.log, model, draws=draws, method=ParticleGibbs(metropolis_steps=_METROPOLIS_STEPS),
                    seed=self.settings.seed, progress=reporter.live,
                )  # fmt: skip
        except (FilterError, SamplingError) as error:
            self.notes.append(f"there is no posterior by full chains: {error}")
            return None

    def _result(self, first: JudgedFit, last: JudgedFit, draws: int, chains: bool) -> Criticism:
        """Return the result; `chains` tells whether full chains of the final model are run."""
        before, after, posterior = estimates(first.fit), estimates(last.fit), None
        model = last.fit.bound.model
        if chains:
            posterior = self._calibrated(model, draws)
        if posterior is not None:
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
            with_window(with_estimates_of(self._with_drive(answer), effect, after, model.fixed), effect, window)
            for answer, effect, window in zip(self.answers, added, windows, strict=True)
        )
        unexplained = unexplained_of(last, self.search.directions)
        verdict = verdict_of(found, last.judgement)
        lost = ""
        if self.loss is not None and (self.loss.partial or not found):
            lost = self.loss.what
            verdict, unexplained = UNKNOWN, (self.loss.place, *unexplained)
        # The model that is handed over applies to other logs as well: its formulas are evaluated anew on each.
        model = replace(model, effects=tuple(portable(effect) for effect in model.effects))
        log = with_estimates(self.log, last.fit.tables, last.fit.path) if path_formulas(model.effects) else self.log
        return Criticism(
            verdict=verdict,
            sentence=sentence_of(verdict, found, unexplained, self.steps, before, after, self.log, lost),
            effects=found,
            unexplained=unexplained,
            steps=tuple(self.steps),
            base=self.base,
            model=model,
            before=before,
            after=after,
            log=log,
            split=self.split,
            held_out=self.other,
            first=first,
            last=last,
            posterior=posterior,
            notes=tuple(self.notes),
            settings=self.settings.recorded(self.split, self.log.fingerprint(), self.other),
            nothing_probability=self.nothing_probability,
        )


def _gain(after: HeldOut | None, before: HeldOut | None) -> Gain:
    """Return the gain on held-out rows of one model over another; NaN where a filter loses the robot."""
    if after is None or before is None:
        return Gain(np.nan, np.nan)
    return paired_gain(after.rows, before.rows, slice(None))
