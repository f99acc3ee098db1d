"""What the result of the critic says of the full chains of its final model."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import xarray as xr

from pmcl.criticism import conclusion
from pmcl.criticism.settings import Settings
from pmcl.posterior.compat import assemble

# mypy: disable-error-code="no-untyped-def"


@pytest.mark.parametrize("converged", [True, False])
def test_a_note_tells_where_the_chains_have_not_converged(monkeypatch, rng, converged):
    draws = rng.normal(size=(4, 1000))
    draws[0] += 0.0 if converged else 1.0
    posterior = assemble({"posterior": xr.Dataset({"sigma_range": (("chain", "draw"), draws)})}, {})
    monkeypatch.setattr(conclusion, "calibrate", lambda *given, **options: posterior)
    settings = Settings(particles=100, seed=0, level=0.05, simulations=30, paths=5, workers=1, progress=False)
    task = SimpleNamespace(search=SimpleNamespace(settings=settings), log=None)
    fit = SimpleNamespace(bound=SimpleNamespace(model=None))
    found, notes = conclusion._calibrated(task, fit, 1000)
    assert found is posterior
    if converged:
        assert notes == ()
    else:
        (note,) = notes
        assert note.startswith("full chains of the final model: Not converged")
        assert "sigma_range has R-hat" in note
