"""Run several methods on one log, each for the same time, and measure them against a long reference run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.calibration.particle_gibbs import ParticleGibbs
from pmcl.checks import check_flag, check_number, check_seed, check_type, check_whole
from pmcl.comparison.curves import Curve, Reference, learning_curve, reference_of
from pmcl.comparison.held_out import HeldOut, held_out_worth, peak_memory
from pmcl.comparison.methods import ComparedMethod, as_methods, draw
from pmcl.errors import LogError, ModelError, PmclError, SamplingError
from pmcl.interrupts import stopping_on_interrupt
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel, RobotModel, default_model
from pmcl.posterior.diagnostics import R_HAT_LIMIT
from pmcl.sampling.chains import Chains, PointEstimate
from pmcl.sampling.options import RunOptions
from pmcl.sampling.stopwatch import Stopwatch

__all__ = ["Comparison", "Failure", "MethodResult", "compare"]

Float = NDArray[np.float64]

# More particles than a method needs by itself: the reference should owe nothing to their number.
_REFERENCE = ComparedMethod(
    "conditional", ParticleGibbs(particles=50, sweeps_per_draw=1), "particle Gibbs with more particles than it needs"
)
# A run that only compiles has so many draws of so many chains.
_SHORTEST = RunOptions(draws=4, chains=2, trajectories=1)


@dataclass(frozen=True)
class MethodResult:
    """What one method found in its time.

    Attributes
    ----------
    method : ComparedMethod
        The method.
    chains, draws : int
        Chains (for the ensemble, walkers), and draws of each after burn-in.
    seconds, burn_in, burn_in_cpu : float
        Seconds that the whole run took by the clock, and those before the first draw by the clock and of all cores
        together.
    mean, sd : ndarray, shape (d,)
        Mean and standard deviation of its draws; of a point estimate, the estimate and its standard error (NaN when
        there is none).
    curve : Curve
        What its first draws gave, for growing numbers of them; the last point has all draws.
    memory : float
        By how much the process grew at most while it ran [MB]; NaN where the system does not tell.
    held_out : HeldOut, optional
        What its mean is worth on rows that it has not seen; None when no rows were held out.
    """

    method: ComparedMethod
    chains: int
    draws: int
    seconds: float
    burn_in: float
    burn_in_cpu: float
    mean: Float
    sd: Float
    curve: Curve
    memory: float = np.nan
    held_out: HeldOut | None = None

    @property
    def ess_per_cpu_second(self) -> float:
        """Effective draws of the worst parameter for each CPU second, burn-in left out."""
        return float(self.curve.ess[-1] / max(self.curve.cpu[-1] - self.burn_in_cpu, 1e-9))


class Failure(NamedTuple):
    """A method that gave no draws in its time, and why."""

    method: ComparedMethod
    reason: str


@dataclass(frozen=True)
class Comparison:
    """Methods on one log.

    Attributes
    ----------
    log : str
        Name of the log.
    names, units : tuple of str
        Parameters.
    truth : ndarray of shape (d,) or None
        True parameters, when the log is simulated.
    reference : Reference
        The posterior by a longer run of another seed.
    reference_method : ComparedMethod
    reference_seconds : float
        How long that run took by the clock.
    results : tuple of MethodResult
        In the order asked for.
    seconds : float
        Time that each method had.
    chains, seed : int
        Settings.
    failures : tuple of Failure
        Methods that could not start, or made no draw in their time.
    held_out_rows : int
        Rows at the end of the log that no method has seen.
    reference_held_out : HeldOut, optional
        What the mean of the reference is worth on them.
    """

    log: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    truth: Float | None
    reference: Reference
    reference_method: ComparedMethod
    reference_seconds: float
    results: tuple[MethodResult, ...]
    seconds: float
    chains: int
    seed: int
    failures: tuple[Failure, ...] = ()
    held_out_rows: int = 0
    reference_held_out: HeldOut | None = None

    @property
    def converged(self) -> bool:
        """Whether the reference can be believed."""
        return self.reference.r_hat <= R_HAT_LIMIT


@stopping_on_interrupt()
def compare(
    log: RobotLog,
    methods: str | Sequence[Any],
    model: RobotModel | None = None,
    *,
    seconds: float = 60.0,
    chains: int = 4,
    seed: int = 0,
    held_out: float = 0.0,
    progress: bool = False,
) -> Comparison:
    """Compare methods by what they reach in the same time.

    Parameters
    ----------
    log : RobotLog
        The log.
    methods : str or sequence of CalibrationMethod or ComparedMethod
        Text as :func:`pmcl.comparison.methods.parse_methods` reads it, such as
        ``"conditional:25,smoothing:500,ensemble"``.
    model : RobotModel, optional
        The log's default model when left out.
    seconds : float
        Wall time of each method, burn-in included [s]; the reference takes twice as long. Where the usual burn-in
        would take more than half of it, a shorter one is made. Compilation is not counted: every method runs for a
        moment before its clock starts.
    chains : int
        Chains of each method, at least two.
    seed : int
        Seeds of all runs follow from it. How many draws fit into the time depends on the machine.
    held_out : float
        Share of the log, at its end, that neither methods nor reference see, up to 0.5. A filter with the mean of each
        is then scored on it.
    progress : bool
        Show a progress bar for each method.

    Returns
    -------
    Comparison

    Raises
    ------
    PmclError
        When the methods cannot be read, `seconds` or `chains` are not usable, log and model do not fit each other, or
        the reference cannot start. A method that cannot is no error, but one of the result's `failures`.
    """
    compared = as_methods(methods)
    seconds = check_number("seconds", seconds, 0.0, unit="s", open_low=True, error=SamplingError, advice="60 is usual")
    chains = check_whole("chains", chains, 2, error=SamplingError, advice="4 are usual")
    seed = check_seed(seed, error=SamplingError)
    advice = "0.25 is usual, 0 holds nothing out"
    held_out = check_number("held_out", held_out, 0.0, 0.5, error=SamplingError, advice=advice)
    check_flag("progress", progress, error=SamplingError)
    check_type("log", log, RobotLog, error=LogError, advice="read one with pmcl.read_log")
    if model is not None:
        check_type("model", model, RobotModel, error=ModelError, advice="leave it out for the default model")
    whole, split = log, log.n_steps - round(held_out * log.n_steps)
    if split < whole.n_steps:
        log = whole.select(0, split)
    model = default_model(whole) if model is None else model
    bound = model.bind(log)
    known = log.true_theta or {}
    truth = np.array([known[name] for name in bound.names]) if set(bound.names) <= set(known) else None

    def worth(theta: Float) -> HeldOut | None:
        values = dict(zip(bound.names, theta.tolist(), strict=True))
        return held_out_worth(whole, model, values, split, seed) if split < whole.n_steps else None

    first, *seeds = (int(s) for s in np.random.SeedSequence(seed).generate_state(1 + len(compared)))
    _compile(bound, compared)
    try:
        drawn, stopwatch = _timed(_REFERENCE, bound, chains, first, 2.0 * seconds, "reference", progress)
    except PmclError as error:
        raise SamplingError(f"the reference run, {_REFERENCE} in {2.0 * seconds:g} s, gave no draws: {error}") from None
    assert isinstance(drawn, Chains)
    reference = reference_of(drawn.theta)
    results, failures = [], []
    for method, method_seed in zip(compared, seeds, strict=True):
        try:
            with peak_memory() as peak:
                found, clock = _timed(method, bound, chains, method_seed, seconds, str(method), progress)
        except PmclError as error:
            failures.append(Failure(method, str(error)))
            continue
        measured = _measured(method, found, clock, reference, truth)
        results.append(replace(measured, memory=peak.value, held_out=worth(measured.mean)))
    return Comparison(
        log=log.robot or log.where,
        names=bound.names,
        units=tuple(parameter.unit for parameter in bound.parameters),
        truth=truth,
        reference=reference,
        reference_method=_REFERENCE,
        reference_seconds=stopwatch.seconds,
        results=tuple(results),
        seconds=seconds,
        chains=chains,
        seed=seed,
        failures=tuple(failures),
        held_out_rows=whole.n_steps - split,
        reference_held_out=worth(reference.mean),
    )


def _compile(bound: BoundModel, methods: Sequence[ComparedMethod]) -> None:
    """Run every kind of method for a moment, so that no method's time goes into compiling or importing."""
    kinds = {type(compared.method): compared.method for compared in (*methods, _REFERENCE)}
    for method in kinds.values():
        # A mistake in the log is reported by the run that is measured.
        with suppress(PmclError):
            method.shortest().run(bound, _SHORTEST)


def _timed(
    method: ComparedMethod, bound: BoundModel, chains: int, seed: int, seconds: float, label: str, progress: bool
) -> tuple[Chains | PointEstimate, Stopwatch]:
    with _bar(label, seconds, progress) as show_seconds:
        stopwatch = Stopwatch(seconds, show_seconds)
        drawn = draw(method, bound, chains, seed, stopwatch)
        stopwatch.stop()
        return drawn, stopwatch


def _measured(
    method: ComparedMethod,
    found: Chains | PointEstimate,
    stopwatch: Stopwatch,
    reference: Reference,
    truth: Float | None,
) -> MethodResult:
    chains = found.as_chains() if isinstance(found, PointEstimate) else found
    n_draws = chains.n_draws
    flat = chains.theta.reshape(-1, chains.theta.shape[-1])
    if isinstance(found, Chains) and len(flat) > 1:
        sd = flat.std(axis=0, ddof=1)
    else:
        error = found.standard_error if isinstance(found, PointEstimate) else None
        sd = error if error is not None else np.full(flat.shape[1], np.nan)
    times = stopwatch.draw_times(n_draws)
    return MethodResult(
        method=method,
        chains=chains.n_chains,
        draws=n_draws,
        seconds=stopwatch.seconds,
        burn_in=times.burn_in,
        burn_in_cpu=times.burn_in_cpu,
        mean=flat.mean(axis=0),
        sd=sd,
        curve=learning_curve(chains.theta, np.array(times.wall), np.array(times.cpu), reference, truth),
    )


@contextmanager
def _bar(label: str, seconds: float, progress: bool) -> Iterator[Callable[[float], None] | None]:
    """Give a function that moves a bar to a number of seconds."""
    if not progress:
        yield None
        return
    from tqdm import tqdm

    with tqdm(total=seconds, desc=f"{label:<16}", unit="s", bar_format="{l_bar}{bar}| {n:.0f}/{total:.0f} s") as bar:

        def move(now: float) -> None:
            bar.update(min(now, seconds) - bar.n)

        yield move
