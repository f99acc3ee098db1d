from __future__ import annotations

import pytest
import synthetic_posterior

from pmcl.posterior.convert import to_arviz


@pytest.fixture(scope="session")
def case():
    return synthetic_posterior.fake_case()


@pytest.fixture(scope="session")
def data(case):
    return to_arviz(case.chains, case.parameters, case.logs)
