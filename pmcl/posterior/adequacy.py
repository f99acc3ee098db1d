"""Whether the calibrated model fits its log, as the posterior file records it: the second half of the verdict."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import Posterior, attributes, find_group

__all__ = ["Adequacy", "adequacy", "warnings_of_preflight"]

# More findings than this are counted, not listed.
_MOST_NAMED = 3


class Adequacy(NamedTuple):
    """Whether the model fits.

    Attributes
    ----------
    adequate : bool or None
        None when it was not checked, as in files of older versions and of other programs.
    sentence : str
        One sentence, beginning in lower case and without a full stop; empty when not checked.
    advice : tuple of str
        Advice for the user.
    """

    adequate: bool | None
    sentence: str
    advice: tuple[str, ...]


def adequacy(data: Posterior) -> Adequacy:
    """Read the model check and the warnings about the log that a posterior keeps.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    Adequacy
        Not adequate when the model check found a deviation, or when a warning names a mistake in the log, such as
        swapped axes, that explains the readings better than the log as it is.
    """
    check = find_group(data, "predictive_check").attrs
    checked = "adequate" in check
    findings = _findings(check.get("findings"), "findings") if checked else ()
    warnings = warnings_of_preflight(data)
    mistakes = [str(warning["message"]).rstrip(".") for warning in warnings if warning.get("mistake")]
    advice = tuple(str(warning["message"]) for warning in warnings if not warning.get("mistake"))
    if mistakes:
        remedy = "Mend the log and calibrate again: these numbers describe another robot."
        return Adequacy(False, f"the log looks mistaken: {_listed(mistakes)}", (remedy, *advice))
    if not checked:
        return Adequacy(None, "", advice)
    if int(check["adequate"]):
        probability = f"p = {float(check['p_value']):.2g}"
        sentence = f"the model fits: its predictions of {int(check['readings'])} readings show nothing unusual"
        return Adequacy(True, f"{sentence} ({probability})", advice)
    several = len({finding["log"] for finding in findings}) > 1 or any(finding["log"] for finding in findings)
    named = [
        f"{finding['message']} in log {finding['log']}" if several else str(finding["message"]) for finding in findings
    ]
    remedy = (
        "Use another starting belief, more particles during burn-in, or --outliers, which allows for gross errors."
        if any(finding["name"] == "lost" for finding in findings)
        else "Run 'pmcl criticize' before you use these numbers: it finds which effect the model lacks."
    )
    return Adequacy(False, f"readings and model disagree: {_listed(named)}", (remedy, *advice))


def warnings_of_preflight(data: Posterior) -> tuple[dict[str, Any], ...]:
    """Return the warnings about the log that were found before sampling.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of dict
        Each with "name", "level", "mistake" (whether a named mistake explains the log better) and "message".

    Raises
    ------
    PosteriorError
        If the attribute ``preflight`` holds something else.
    """
    return _findings(attributes(data).get("preflight", ""), "preflight")


def _findings(stated: Any, name: str) -> tuple[dict[str, Any], ...]:
    """Read findings that a file holds as JSON."""
    try:
        found = json.loads(stated) if isinstance(stated, str) and stated else [] if isinstance(stated, str) else None
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, list) or not all(isinstance(each, dict) and "message" in each for each in found):
        raise PosteriorError(
            f"expected attribute {name} as JSON list of findings, got {stated!r:.60}: run 'pmcl calibrate' again"
        )
    return tuple(found)


def _listed(sentences: list[str]) -> str:
    rest = len(sentences) - _MOST_NAMED
    return "; ".join(sentences[:_MOST_NAMED]) + (f"; and {rest} more" if rest > 0 else "")
