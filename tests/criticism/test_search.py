"""When a finding needs no further look at the alarm that it explains."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from pmcl.criticism.heldout import Gain
from pmcl.criticism.search import Outcome

# mypy: disable-error-code="no-untyped-def"


@pytest.mark.parametrize(
    ("heldout", "whole", "certain"),
    [
        (Gain(10.0, 4.0), Gain(12.0, 8.0), True),  # the held-out part says it alone
        (Gain(10.0, 7.0), Gain(40.0, 9.0), True),  # the whole log leaves no doubt
        (Gain(10.0, 7.0), Gain(40.0, 25.0), False),  # one row may have made all of that
        (Gain(10.0, 7.0), Gain(14.0, 3.0), False),  # so much some candidate may gain by chance
        (Gain(-5.0, 7.0), Gain(40.0, 9.0), False),
        (Gain(2.0, 0.5), Gain(40.0, 9.0), False),  # never worth a parameter
    ],
)
def test_an_alarm_in_doubt_is_settled_by_a_clear_gain(heldout, whole, certain):
    trial = SimpleNamespace(on_heldout=heldout, on_all=whole)
    assert Outcome(trial, None, [trial]).certain is certain


def test_nothing_found_settles_nothing():
    assert not Outcome(None, None, []).certain
