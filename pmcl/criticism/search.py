"""The search for a name: what is refitted, on which rows, and what counts as an answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.alarms import Judgement
from pmcl.criticism.assemble import found_effect
from pmcl.criticism.fit import BRIEF, GLANCE, THOROUGH, Effort, Fit, quick_fit
from pmcl.criticism.formulas import formulas
from pmcl.criticism.naming import (
    choose,
    confirmed_without_score,
    contenders,
    contenders_when_lost,
    leaders,
    of_a_carrier,
    of_the_sensors,
    of_the_whole_robot,
    scan,
    shortlist,
    untried,
    untried_twins,
    with_rules,
    worth_it,
)
from pmcl.criticism.passes import (
    FINER,
    Judged,
    Settings,
    candidate_directions,
    criticised,
    judged_again,
    key_of,
    looked_again,
    split_again,
)
from pmcl.criticism.result import FoundEffect, Pass
from pmcl.criticism.scores import Direction, directions, effect_rows
from pmcl.criticism.trials import Trial, refitted, scored_anew, trial_of_base, try_effect
from pmcl.criticism.verdict import WORTH_A_FORMULA, called
from pmcl.criticism.waves import remarkable_waves
from pmcl.errors import CriticismError, FilterError
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import readings
from pmcl.models.effects.effect import Effect

__all__ = ["FIT_SHARE", "LATER", "Outcome", "Search"]

# Share of the rows on which models are fitted; and the share for an effect that comes too late for that.
FIT_SHARE, LATER = 0.6, 0.8
_LEAST_READINGS = 20
# A score that is remarkable comes late when this share of it is not in the fit part; evenly spread, 0.77 would be.
_ALREADY = 0.5
_FORMULAS = 4
# Models of a robot that was lost with which the filter is run again.
_FOLLOWED = 3
# Formulas compete with a known effect when their score is greater, with an absorber when it is this share of its own;
# unless their rows run like those of the effect: then they are the effect, in other words.
_NEARLY = 0.5
_THE_SAME = 0.98
# Particles that are enough for a glance.
_AT_A_GLANCE = 2000
# So many times the particles compare models that held-out rows do not confirm.
_FINEST = 4


class Outcome(NamedTuple):
    """What a search came to.

    Attributes
    ----------
    accepted : Trial or None
        The model with the effect that explains the alarms.
    found : FoundEffect or None
        What is known of that effect.
    trials : list of Trial
        All that was refitted.
    """

    accepted: Trial | None
    found: FoundEffect | None
    trials: list[Trial]

    @property
    def certain(self) -> bool:
        """Whether the effect is confirmed so clearly that a doubtful alarm need not be looked into."""
        return self.accepted is not None and self.accepted.confirmed


class _Rules(NamedTuple):
    """Formulas that were refitted, the directions that were scored for them, and what their scores say."""

    trials: list[Trial]
    wanted: tuple[Direction, ...]
    judgement: Judgement
    critical_z: float


class Search:
    """Searches through the candidates for one log.

    Attributes
    ----------
    log : RobotLog
        The log.
    offered : tuple of Effect
        What the catalogue offers.
    settings : Settings
        Of the run.
    split : int
        First row of the held-out part.
    wanted : tuple of Direction
        The candidates of the last pass,
    judged : Judged
        and what it said of them.
    """

    def __init__(self, log: RobotLog, offered: Sequence[Effect], settings: Settings) -> None:
        self.log, self.offered, self.settings = log, tuple(offered), settings
        self.split = int(FIT_SHARE * log.n_steps)
        parts = [_readings(log, rows) for rows in (slice(0, self.split), slice(self.split, None))]
        if min(parts) < _LEAST_READINGS:
            raise CriticismError(
                f"{log.where}: expected at least {_LEAST_READINGS} readings in the first 60 % of the log and in the "
                f"rest, but got {parts[0]} and {parts[1]}; record more"
            )
        self.wanted: tuple[Direction, ...] = ()
        self.judged: Judged
        # What was refitted since the last pass, by effect, number of particles and first row of the held-out part.
        self._refitted: dict[tuple[Any, int, int], Trial] = {}

    def criticised(self, fit: Fit) -> Pass:
        """Criticise a fit of the whole log."""
        self.wanted = candidate_directions(self.log, fit, self.offered)
        self.judged = criticised(self.log, fit, self.wanted, self.split, self.settings)
        self._refitted = {}
        return Pass(fit, self.judged.evidence, self.judged.judgement)

    def looked_again(self, last: Pass) -> Pass:
        """Judge a pass by more simulated logs; what was refitted stays."""
        self.judged = looked_again(self.judged, self.log, last.fit, self.wanted, self.split, self.settings)
        return replace(last, evidence=self.judged.evidence, judgement=self.judged.judgement)

    def trial_of(self, last: Pass) -> Trial:
        """Fit the model of a pass on the fit part; gaps are always those of held-out data."""
        return trial_of_base(
            last.fit.bound.model, self.log, self.split, seed=self.settings.seed + 100,
            particles=self.settings.comparing, theta=last.fit.theta, path=last.fit.path, draws=last.fit.draws,
        )  # fmt: skip

    def told(self, last: Pass) -> tuple[Trial, FoundEffect] | None:
        """Return the model with an effect that the data show by themselves, as rounding shows in their digits.

        How readings scatter says little about such an effect; it is added unless it makes predictions worse.
        """
        shown = [one.effect for one in self.wanted if one.effect.tells is not None and one.effect.tells(self.log)]
        for effect in shown:
            (trial,) = self._tried(self.trial_of(last), [(effect, 0.0)]) or (None,)
            if trial is not None and trial.on_all.total > -max(3.0, 2.0 * trial.on_all.se):
                return trial, replace(found_effect(trial, (), last.judgement, self.wanted), p_value=0.0)
        return None

    def named(self, last: Pass, current: Trial, everywhere: bool = True) -> Outcome:
        """Look for what explains the alarms of a pass, whose model is fitted as `current`.

        First among the likeliest of the catalogue; where that does not help, and `everywhere`, among all effects of the
        whole robot and outside of the catalogue.
        """
        settings, z = self.settings, self.judged.z
        scanned = scan(current.fit.bound, current.fit.theta, self.wanted, z, settings.seed, settings.particles)
        trials = self._tried(current, shortlist(self.wanted, z, scanned, last.judgement))
        best, _ = choose(trials)
        if best is not None and best.effect is not None and best.effect.absorber:
            more = shortlist(self.wanted, z, scanned, last.judgement, more=True)
            trials += self._tried(current, untried(more, trials), trials)
            best, _ = choose(trials)
        if best is not None and best.effect is not None:
            trials += self._tried(current, untried_twins(best.effect, self.wanted, z, trials), trials)
        current, trials = self._beyond_chance(current, self._settled(current, trials), last.judgement.critical_z)
        best, _ = choose(trials)
        if best is not None and worth_it(best, last.judgement.critical_z):
            if everywhere and _explains_too_little(best, last.judgement):
                return self._elsewhere(last, current, trials)
            return self._beside_rules(last, current, trials, self._rules(last, current, best))
        # What comes too late for the fit part is looked for on a longer one, not among all that is left.
        if not everywhere or last.judgement.p_value > WORTH_A_FORMULA or self.comes_late(last):
            return Outcome(None, None, trials)
        return self._elsewhere(last, current, trials)

    def formula(self, last: Pass, current: Trial) -> Outcome:
        """Look outside the catalogue."""
        return self._rule_alone(self._rules(last, current))

    def _elsewhere(self, last: Pass, current: Trial, trials: list[Trial]) -> Outcome:
        """Look outside the catalogue, and among all effects of the whole robot, whatever their scores.

        Formulas come first: where one of them explains the log, most of those many effects gain next to nothing beside
        it at a glance.
        """
        rules = self._rules(last, current)
        rule = self._rule_alone(rules).accepted
        rivals = [rule] if rule is not None else []
        left = untried(of_the_whole_robot(self.wanted, self.judged.z), trials)
        trials = self._settled(current, trials + self._tried(current, left, trials + rivals), rivals)
        best, _ = choose(trials)
        if best is None or not worth_it(best, last.judgement.critical_z):
            outcome = self._rule_alone(rules)
            return outcome._replace(trials=trials + outcome.trials)
        return self._beside_rules(last, current, trials, rules)

    def _rule_alone(self, rules: _Rules) -> Outcome:
        """Return what formulas come to where nothing known is confirmed."""
        best, _ = choose(rules.trials)
        if best is None or not worth_it(best, rules.critical_z):
            return Outcome(None, None, rules.trials)
        return Outcome(best, found_effect(best, (), rules.judgement, rules.wanted), rules.trials)

    def _beside_rules(self, last: Pass, current: Trial, trials: list[Trial], rules: _Rules) -> Outcome:
        """Return what the best known effect, which is confirmed, comes to after formulas have competed with it."""
        best, twins = choose(trials)
        assert best is not None
        winner, _ = with_rules(best, twins, rules.trials, rules.critical_z)
        if winner is not best and winner.effect is not None:
            # Nothing is called a rule of its own before all that is known of its carrier has been refitted.
            known = of_a_carrier(self.wanted, self.judged.z, winner.effect.carrier)
            more = self._settled(current, self._tried(current, untried(known, trials), [best, winner]), [best])
            confirmed = [trial for trial in more if worth_it(trial, last.judgement.critical_z)]
            best, twins = choose([best, *confirmed, *(trial for trial in trials if trial is not best)])
            assert best is not None
            trials = trials + more
        best, twins = with_rules(best, twins, rules.trials, rules.critical_z)
        judged = last.judgement, self.wanted
        if any(best is rule for rule in rules.trials):
            judged = rules.judgement, rules.wanted
        return Outcome(best, found_effect(best, twins, *judged), trials + rules.trials)

    def _rules(self, last: Pass, current: Trial, best: Trial | None = None) -> _Rules:
        """Refit the formulas with remarkable scores; where a known effect is the best, those that may be better."""
        absorbs = best is not None and best.effect is not None and best.effect.absorber
        # How noise grows with motion is in the catalogue; only what is called by a general name may be a rule for it.
        offered = formulas(self.log, last.fit.tables, last.fit.path, of_noise=best is None or absorbs)
        wanted: tuple[Direction, ...] = directions(offered)
        if not wanted:
            return _Rules([], (), last.judgement, np.inf)
        evidence, judgement, z, _ = judged_again(self.judged, wanted, self.split, self.settings)
        # Noise with a memory, or more noise, takes up much of what follows a rule: it has the greater score then.
        beyond = (_NEARLY if absorbs else 1.0) * abs(best.z) if best is not None else 0.0
        remarkable = (np.abs(judgement.z) > judgement.critical_z) & (np.abs(z) > beyond)
        order = [int(k) for k in np.argsort(-np.abs(z)) if remarkable[k]]
        if best is not None:
            known = [row for row, one in zip(self.judged.evidence.scores, self.wanted, strict=True)
                     if one.effect is best.effect]  # fmt: skip
            order = [k for k in order if not any(_alike(evidence.scores[k], row) for row in known)]
        waves = remarkable_waves(self.judged, self.log, last.fit.tables, self.split, self.settings, beyond)
        chosen = [(wanted[k].effect, float(z[k])) for k in order[:_FORMULAS]] + waves.found
        rivals = [best] if best is not None else []
        trials = self._settled(current, self._tried(current, chosen, rivals), rivals)
        critical = max(judgement.critical_z, waves.critical_z)
        if best is None or any(trial.merit > best.merit for trial in trials):
            _, trials = self._beyond_chance(current, trials, critical)
        return _Rules(trials, wanted, judgement, critical)

    def fair(self, current: Trial) -> Trial:
        """Return a model to compare others with, its rows scored with as many particles as theirs are now."""
        seed, particles = self.settings.seed + 100, self.settings.comparing
        if current.particles == particles:
            return current
        return scored_anew(current, current, self.log, self.split, seed=seed, particles=particles)

    def found_again(self, fit: Fit, follow: Callable[[Fit], None]) -> tuple[Trial, list[Trial]] | None:
        """Look for an effect with which the filter follows a robot that it loses without.

        Scores of a lost filter mean nothing, but a trajectory that is updated with the parameters is not lost so
        easily: all effects of the motion are refitted, and if none helps those of the sensors. Along that trajectory
        scores still tell which beams and landmarks are the likeliest. A sensor that is trusted less lets a filter
        follow where its motion is wrong: what gains less than a confirmed effect that does not is not accepted.
        Return the best of the effects with which the filter follows, and all trials, or None. `follow` raises
        FilterError where a filter does not.
        """
        self.wanted = candidate_directions(self.log, fit, self.offered)
        split, seed, particles = self.split, self.settings.seed + 100, self.settings.comparing
        trials: list[Trial] = []
        try:
            current = trial_of_base(
                fit.bound.model, self.log, split, seed=seed, particles=particles, theta=fit.theta, path=fit.path,
                draws=fit.draws,
            )  # fmt: skip
        except FilterError:
            return None
        self.settings.tell("the filter loses the robot: refitting all effects of its motion, then of its sensors")
        scores = effect_rows(fit.tables, self.log, np.ascontiguousarray(fit.path.T[None]), self.wanted)
        z = scores.sum(axis=1) / np.sqrt((scores**2).sum(axis=1) + np.finfo(float).tiny)
        z = np.where([one.one_sided for one in self.wanted], np.maximum(z, 0.0), z)
        least = 0.0
        for offered in (of_a_carrier(self.wanted, z, "motion"), of_the_sensors(self.wanted, z)):
            # The scores rank, no more: what they are when the model is right nobody knows.
            new = self._settled(current, self._tried(current, [(effect, 0.0) for effect, _ in offered], lost=True))
            trials += new
            confirmed = [one for one in new if one.merit > least and confirmed_without_score(one, current)]
            for trial in sorted(confirmed, key=lambda one: -one.merit)[:_FOLLOWED]:
                bound = trial.model.bind(self.log)
                try:
                    follow(quick_fit(bound, seed, theta=trial.fit.theta, path=fit.path, draws=trial.fit.draws))
                except FilterError:
                    continue
                return trial, trials
            least = max((one.merit for one in confirmed), default=0.0)
        return None

    def comes_late(self, last: Pass) -> bool:
        """Tell whether a candidate is remarkable in the whole log, and hardly so in the part that is fitted on."""
        if self.split != int(FIT_SHARE * self.log.n_steps):
            return False
        later = int(LATER * self.log.n_steps)
        if _readings(self.log, slice(later, None)) < _LEAST_READINGS or last.judgement.p_value > WORTH_A_FORMULA:
            return False
        whole, early = np.abs(last.judgement.z), np.abs(self.judged.z)
        return bool(((whole > last.judgement.critical_z) & (early < _ALREADY * whole)).any())

    def split_at(self, share: float) -> None:
        """Hold out other rows."""
        self.settings.tell(f"holding out the last {100 * (1 - share):.0f} % of the rows", "looking again")
        self.split = int(share * self.log.n_steps)
        self.judged = split_again(self.judged, self.wanted, self.split, self.settings)

    def _beyond_chance(self, current: Trial, trials: list[Trial], critical_z: float) -> tuple[Trial, list[Trial]]:
        """Return the current model and trials, scored with more particles where only these confirm the best trial.

        The better a model, the fewer of its particles survive a reading at an edge: a single row may take back all
        that a right effect gains, by chance. Where that was so all models are scored with more from then on.
        """
        best, _ = choose(trials)
        if best is None or not best.on_fit.significant or worth_it(best, critical_z):
            return current, trials
        if self.settings.finer > FINER:
            return current, trials
        self.settings.tell("held-out rows do not confirm it: scoring with more particles")
        before, self.settings = self.settings, replace(self.settings, finer=_FINEST * self.settings.finer)
        same, doubted = self.fair(current), leaders(trials)

        def one(k: int) -> Trial:
            seed, particles = self.settings.seed + 100, self.settings.comparing
            return scored_anew(doubted[k], same, self.log, self.split, seed=seed, particles=particles)

        finer = self.settings.mapped(one, "scoring with more particles", _names_of(doubted))
        scored = _replaced(trials, doubted, finer)
        best, _ = choose(scored)
        if best is not None and worth_it(best, critical_z):
            return same, scored
        self.settings = before
        return current, trials

    def _tried(
        self,
        current: Trial,
        chosen: Sequence[tuple[Effect, float]],
        rivals: Sequence[Trial] = (),
        lost: bool = False,
    ) -> list[Trial]:
        """Refit effects: each at a glance, then those that are not far behind others and `rivals`, in earnest."""
        current, seed, particles = self.fair(current), self.settings.seed + 100, self.settings.comparing
        made_before = [self._refitted.get((key_of(effect), particles, self.split)) for effect, _ in chosen]
        fresh = [one for one, trial in zip(chosen, made_before, strict=True) if trial is None]
        known = [
            replace(trial, effect=effect, z=z)
            for (effect, z), trial in zip(chosen, made_before, strict=True) if trial is not None
        ]  # fmt: skip
        if not fresh:
            return known
        self.settings.tell("refitting " + ", ".join(called(effect) for effect, _ in fresh))
        rivals = [*rivals, *known]

        def tried(k: int, effort: Effort, particles: int) -> Trial | None:
            effect, z = fresh[k]
            return try_effect(current, effect, z, self.log, self.split, seed=seed, particles=particles, effort=effort)

        def at_a_glance(k: int) -> Trial | None:
            # Where a filter needs many particles, its passes take longer than a short fit.
            return tried(k, GLANCE, min(particles, max(_AT_A_GLANCE, particles // 2)))

        def in_earnest(k: int) -> Trial | None:
            glance = glances[k]
            if glance is None:
                return tried(k, BRIEF, particles)
            if not any(glance is one for one in able):
                return glance
            return refitted(glance, current, self.log, self.split, seed=seed, particles=particles, effort=BRIEF)

        alone = len(fresh) + len(rivals) < 2
        names = [called(effect) for effect, _ in fresh]
        glances: list[Trial | None] = [None]
        if not alone:
            glances = self.settings.mapped(at_a_glance, "quick fits of candidates", names)
        seen = [glance for glance in glances if glance is not None]
        able = contenders_when_lost(seen, current) if lost else contenders(seen, rivals)
        made = [one for one in self.settings.mapped(in_earnest, "longer fits of candidates", names) if one is not None]
        self._remember(made, particles)
        return known + made

    def _remember(self, trials: Sequence[Trial], particles: int) -> None:
        for trial in trials:
            assert trial.effect is not None
            self._refitted[key_of(trial.effect), particles, self.split] = trial

    def _settled(self, current: Trial, trials: list[Trial], rivals: Sequence[Trial] = ()) -> list[Trial]:
        """Return the trials, those that lead fitted thoroughly, where more than one leads."""
        first = leaders([*trials, *rivals])
        if len(first) < 2:
            return trials
        first = [one for one in first if not one.thorough and not any(one is rival for rival in rivals)]
        current, seed, particles = self.fair(current), self.settings.seed + 100, self.settings.comparing

        def one(k: int) -> Trial:
            return refitted(first[k], current, self.log, self.split, seed=seed, particles=particles, effort=THOROUGH)

        settled = self.settings.mapped(one, "thorough fits of the leading candidates", _names_of(first))
        self._remember(settled, particles)
        return _replaced(trials, first, settled)


def _names_of(trials: Sequence[Trial]) -> list[str]:
    return ["" if trial.effect is None else called(trial.effect) for trial in trials]


def _replaced(trials: list[Trial], old: list[Trial], new: list[Trial]) -> list[Trial]:
    return [next((n for n, one in zip(new, old, strict=True) if one is trial), trial) for trial in trials]


def _explains_too_little(best: Trial, judgement: Judgement) -> bool:
    """Return whether a model gains less than what an alarm tells must be missing.

    A number that deviates by z standard errors costs a model at least z^2 / 2 nats. What gains less than that, of many
    that were tried, may be the luckiest of those that are next to what is wrong.
    """
    return best.on_all.total < max((0.5 * alarm.z**2 for alarm in judgement.raised), default=0.0)


def _readings(log: RobotLog, rows: slice) -> int:
    tables = (log.dataset[name].values[rows] for name in readings() if name in log.dataset)
    return sum(int((~np.isnan(values)).sum()) for values in tables)


def _alike(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    norm = float(np.sqrt((one @ one) * (other @ other)))
    return norm > 0.0 and abs(float(one @ other)) > _THE_SAME * norm
