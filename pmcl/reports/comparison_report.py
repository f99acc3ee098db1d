"""An HTML page about a comparison of methods: which found the posterior, how well, and how soon."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from pmcl.comparison.compare import Comparison, MethodResult
from pmcl.posterior.diagnostics import R_HAT_LIMIT
from pmcl.reports.comparison_figures import plot_comparison, plot_means
from pmcl.reports.html import page, picture, write_page
from pmcl.reports.tables import Row, Table, aligned, rounded

__all__ = [
    "ComparisonVerdict",
    "column_note",
    "comparison_table",
    "comparison_text",
    "comparison_verdict",
    "expected_error",
    "worth_note",
    "worth_table",
    "write_comparison",
]

# A mean further from the reference than this many standard errors of the two is a wrong result, not noise.
_FAR = 4.0
# Chains with an R-hat above this have no meaningful effective sample size.
_APART = 1.2
# A method that took this many times the time it was given is mentioned.
_LATE = 1.1


class ComparisonVerdict(NamedTuple):
    """The conclusion of the comparison.

    Attributes
    ----------
    converged : bool
        Whether the reference has converged.
    message : str
        One sentence.
    advice : tuple of str
        Further remarks for the reader.
    """

    converged: bool
    message: str
    advice: tuple[str, ...]


def write_comparison(comparison: Comparison, path: str | os.PathLike[str]) -> None:
    """Write one self-contained HTML file about a comparison.

    Parameters
    ----------
    comparison : Comparison
    path : path-like
        An older file of that name is replaced only when the new one is complete.

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    pictures = [
        picture(
            plot_comparison(comparison),
            "Convergence against time",
            "Each curve begins where the burn-in of the method ends. Above, left: R-hat of the worst parameter, minus "
            "its ideal value 1. Above, right: its effective sample size. Below: distance of the posterior mean from "
            f"that of the reference {comparison.reference_method}, and from the true parameters where they are known, "
            "in standard deviations of the posterior. The distance from the truth does not go to zero: the posterior "
            "itself is about one standard deviation away from it.",
        ),
        picture(
            plot_means(comparison),
            "Where the means ended",
            "Posterior mean and standard deviation of each parameter, relative to the reference: 0 is its mean, the "
            "grey band its standard deviation. A method whose bars lie elsewhere samples another density.",
        ),
    ]
    settings = [
        ("log", comparison.log),
        ("time of each method", f"{comparison.seconds:g} s, burn-in included, compilation not"),
        ("chains", str(comparison.chains)),
        ("seed", str(comparison.seed)),
        ("reference", f"{comparison.reference_method}, {comparison.reference_seconds:.0f} s, another seed"),
        ("R-hat of the reference", f"{comparison.reference.r_hat:.4f}"),
        ("effective draws of the reference", f"{comparison.reference.ess:.0f}"),
    ]
    table, worth = comparison_table(comparison), worth_table(comparison)
    text = page(
        "comparison.html.j2",
        title="Methods compared",
        subject=f"{comparison.log}; {comparison.seconds:g} s for each method, {comparison.chains} chains.",
        verdict=comparison_verdict(comparison),
        table=table,
        is_short=lambda row, column: table.rows[row].short and column in table.checked,
        worth=worth,
        worth_note=worth_note(comparison),
        worth_is_short=lambda row, column: worth.rows[row].short and column in worth.checked,
        pictures=pictures,
        methods=[(str(result.method), result.method.description) for result in comparison.results],
        settings=settings,
    )
    write_page(text, path)


def comparison_table(comparison: Comparison) -> Table:
    """Put the results into rows of text; what misses the limit of R-hat, or the reference, is marked."""
    columns = ["method", "draws", "burn-in", "time", "CPU", "R-hat", "ESS", "ESS/s", "error", "expected"]
    if comparison.truth is not None:
        columns.append("truth")
    rows = []
    for result in comparison.results:
        curve = result.curve
        counted = bool(curve.r_hat[-1] <= _APART)
        cells = [
            str(result.method),
            f"{result.chains} x {result.draws}",
            f"{result.burn_in:.1f}",
            f"{result.seconds:.1f}",
            f"{curve.cpu[-1]:.1f}",
            _number(curve.r_hat[-1], 3),
            _number(curve.ess[-1], 0) if counted else "-",
            _rate(result.ess_per_cpu_second) if counted else "-",
            rounded(float(curve.error[-1]), 0.1 * float(curve.error[-1])),
            f"{expected_error(comparison, result):.2g}" if counted else "-",
        ]
        if comparison.truth is not None:
            cells.append(_number(curve.error_of_truth[-1], 2))
        short = not curve.r_hat[-1] <= R_HAT_LIMIT or _elsewhere(comparison, result)
        rows.append(Row(tuple(cells), short))
    for failure in comparison.failures:
        rows.append(Row((str(failure.method), "none", *("-" for _ in columns[2:])), True))
    return Table(tuple(columns), tuple(rows), (columns.index("R-hat"), columns.index("error")))


def worth_table(comparison: Comparison) -> Table:
    """Put what each method costs in memory, and what its mean is worth on held-out rows, into rows of text.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    Table
        With a row for the reference where rows were held out. Marked: a log score that is worse than the reference's by
        four standard deviations over the filter's seeds, or none because the robot was lost.
    """
    columns, rows = ["method", "MB"], []
    found = [(str(result.method), result.memory, result.held_out) for result in comparison.results]
    reference = comparison.reference_held_out
    if reference is not None:
        columns += ["log score", "chance", "position"]
        found.append(("reference", np.nan, reference))
    for name, memory, worth in found:
        cells, short = [name, _number(memory, 0)], False
        if worth is not None and reference is not None:
            cells += [_number(worth.log_score, 3), _number(worth.log_score_error, 3), _number(worth.position_error, 4)]
            chance = np.hypot(worth.log_score_error, reference.log_score_error)
            short = not worth.log_score >= reference.log_score - _FAR * chance
        rows.append(Row(tuple(cells), bool(short)))
    return Table(tuple(columns), tuple(rows), (2,) if reference is not None else ())


def expected_error(comparison: Comparison, result: MethodResult) -> float:
    """Return the distance from the reference's mean that Monte Carlo error alone would give.

    Parameters
    ----------
    comparison : Comparison
        The comparison, with its reference.
    result : MethodResult
        The result of one method.

    Returns
    -------
    float
        In standard deviations of the reference's posterior.

    Notes
    -----
    Both errors count: the method's, one over the root of its effective sample size, and the reference's.
    """
    own = 1.0 / np.sqrt(max(float(result.curve.ess[-1]), 1.0))
    return float(np.hypot(own, comparison.reference.error))


def comparison_verdict(comparison: Comparison) -> ComparisonVerdict:
    """Return which method won, whether the reference has converged, and which method samples another density."""
    reference = comparison.reference
    right = [
        result
        for result in comparison.results
        if result.curve.r_hat[-1] <= R_HAT_LIMIT and not _elsewhere(comparison, result)
    ]
    if not comparison.converged:
        message = (
            f"The reference has not converged (R-hat {reference.r_hat:.3f}, at most {R_HAT_LIMIT} is required): errors "
            "against it say little."
        )
    elif right:
        asked = len(comparison.results) + len(comparison.failures)
        best = max(right, key=lambda result: result.ess_per_cpu_second)
        message = (
            f"{best.method} drew most: {best.ess_per_cpu_second:.3g} effective draws of the worst parameter per CPU "
            f"second; {len(right)} of {asked} methods reached the posterior in "
            f"{comparison.seconds:g} s."
        )
    else:
        message = f"No method reached the posterior in {comparison.seconds:g} s."
    advice = [] if comparison.converged else ["Give more time: --seconds."]
    for failure in comparison.failures:
        advice.append(f"{failure.method} made no draw: {failure.reason}.")
    for result in comparison.results:
        r_hat = result.curve.r_hat[-1]
        if result.seconds > _LATE * comparison.seconds:
            advice.append(
                f"{result.method} took {result.seconds:.1f} s instead of {comparison.seconds:g} s: the shortest run "
                "that it can make takes longer."
            )
        if not np.isfinite(r_hat):
            advice.append(f"{result.method} made {result.draws} draws of each chain, too few to judge: give more time.")
        elif not r_hat <= R_HAT_LIMIT:
            advice.append(f"{result.method} has not converged: R-hat {_number(r_hat, 3)}.")
        elif comparison.converged and _elsewhere(comparison, result):
            advice.append(
                f"{result.method} has converged, but its mean is {result.curve.error[-1]:.2g} posterior standard "
                f"deviations off where {expected_error(comparison, result):.2g} are expected: it samples another "
                "density."
            )
    return ComparisonVerdict(comparison.converged, message, tuple(advice))


def comparison_text(comparison: Comparison) -> str:
    """Return the table as lines for the terminal, with what its columns mean; a star marks what misses a limit."""
    table, worth = aligned(comparison_table(comparison), left=1), aligned(worth_table(comparison), left=1)
    return f"{table}\n\n{column_note(comparison)}\n\n{worth}\n\n{worth_note(comparison)}"


def column_note(comparison: Comparison) -> str:
    """Explain the columns of the table, in lines of at most 100 characters."""
    truth = "; truth: from the true parameters" if comparison.truth is not None else ""
    lines = [
        "draws: chains x draws of each. burn-in, time, CPU: seconds. ESS: effective draws of the worst",
        "parameter; ESS/s: for each CPU second after burn-in. error: distance of the mean from the",
        f"reference's; expected: what chance alone gives{truth}, in posterior sd.",
    ]
    return "\n".join(lines)


def worth_note(comparison: Comparison) -> str:
    """Explain the columns of the second table, in lines of at most 100 characters."""
    lines = ["MB: by how much the process grew at most."]
    if comparison.held_out_rows:
        lines += [
            f"On the last {comparison.held_out_rows} rows, which no method saw, a filter with its mean: log score of a",
            "row [nat], its standard error over the filter's seeds, and position error [m].",
        ]
    return "\n".join(lines)


def _elsewhere(comparison: Comparison, result: MethodResult) -> bool:
    return bool(result.curve.error[-1] > _FAR * expected_error(comparison, result))


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def _rate(value: float) -> str:
    """Return a number with two digits, or more before the point."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
