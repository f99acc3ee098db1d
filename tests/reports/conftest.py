from __future__ import annotations

import sys
from pathlib import Path

import pytest

# The made-up chains are those of the tests of the posterior.
sys.path.insert(0, str(Path(__file__).parents[1] / "posterior"))

import synthetic_posterior

from pmcl.posterior.convert import to_arviz


@pytest.fixture(scope="session")
def report_case():
    return synthetic_posterior.fake_case(n_draws=300, correlation=0.0)


@pytest.fixture(scope="session")
def report_data(report_case):
    return to_arviz(report_case.chains, report_case.parameters, report_case.logs)
