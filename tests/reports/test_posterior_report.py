from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr
from synthetic_posterior import SPREADS, fake_case

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import assemble, extended, find_group, group_names
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.diagnostics import verdict
from pmcl.posterior.log_groups import log_groups
from pmcl.reports import posterior_report
from pmcl.reports.html import Picture, page
from pmcl.reports.log_summary import log_summaries
from pmcl.reports.posterior_report import summary_text, write_report
from pmcl.reports.settings_table import settings_table
from pmcl.reports.tables import rounded


class Reader(HTMLParser):
    """Collects what a browser would: text, and every address it would follow."""

    def __init__(self):
        super().__init__()
        self.text, self.addresses, self.open = [], [], []

    def handle_starttag(self, tag, attrs):
        self.addresses += [value for key, value in attrs if key in ("src", "href", "data", "action")]
        if tag not in ("meta", "img", "br", "link"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open and data.strip():
            self.text.append(data.strip())


def read(path):
    reader = Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    assert reader.open == []
    return reader


@pytest.fixture
def quick(monkeypatch):
    """Pages without their pictures, which take most of the time."""
    monkeypatch.setattr(posterior_report, "_PARAMETER_FIGURES", ())
    monkeypatch.setattr(posterior_report, "_CHAIN_FIGURES", ())
    monkeypatch.setattr(
        posterior_report, "picture", lambda figure, title, caption: Picture(title, caption, "data:,", 10, 10, 6)
    )


@pytest.fixture(scope="module")
def written(report_data, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(report_data, path)
    return path


def without_marks(text):
    """Text without spaces, which the marks of explained terms move."""
    return re.sub(r"\s+", "", text)


def test_the_verdict_comes_first(written, report_data):
    reader = read(written)
    page_text = " ".join(reader.text)
    assert page_text.startswith("Noise model of robot-log0")
    order = [
        "Noise model of robot-log0", "made up; 60 rows over 30 s, 239 readings", "4 chains of 300 draws",
        "The chains have converged", "Where the robot was", "Parameters", "Prior and posterior", "Chains", "Traces",
        "Settings of the run",
    ]  # fmt: skip
    places = [page_text.index(part) for part in order]
    assert places == sorted(places)
    assert without_marks(verdict(report_data).message) in without_marks(page_text)


def test_the_page_needs_nothing_else(written):
    addresses = read(written).addresses
    assert len(addresses) == 7
    for address in addresses:
        head, content = address.split(",", 1)
        assert head == "data:image/png;base64"
        assert base64.b64decode(content, validate=True).startswith(b"\x89PNG")
    assert not re.search(r"https?://|@import|url\(|<script|<link", written.read_text(encoding="utf-8"))


def test_numbers_settings_priors_and_statistics_are_on_the_page(written, report_case):
    text = read(written).text
    for expected in ("sigma_turn", "rad", "0.01950", "kernel", "conditional", "hash-log0", "gamma(2, scale=0.05)"):
        assert expected in text
    assert str(2**80 + 1) in text
    mean = np.nanmean(report_case.chains.statistics["path_update_rate"], axis=1)
    row = text.index("path_update_rate")
    assert text[row + 1 : row + 5] == [f"{value:.4g}" for value in mean]
    assert "acceptance_rate, sigma_range" in text


def test_the_same_posterior_gives_the_same_file(report_data, written, tmp_path):
    write_report(report_data, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == written.read_bytes()


@pytest.mark.usefixtures("quick")
def test_everything_is_escaped(tmp_path):
    case = fake_case(n_draws=20)
    evil = "<script>alert('x')</script>"
    chains = replace(case.chains, settings={"note": evil, evil: "1"})
    parameters = [replace(one, description=evil) for one in case.parameters]
    write_report(to_arviz(chains, parameters, case.logs), tmp_path / "r.html")
    assert "<script" not in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert read(tmp_path / "r.html").text.count(evil) >= 5


def test_a_template_that_misses_content_fails():
    with pytest.raises(Exception, match="is undefined"):
        page("posterior.html.j2", title="x")


@pytest.mark.usefixtures("quick")
def test_bad_news_and_advice_are_shown(tmp_path):
    case = fake_case(n_draws=100)
    density = case.chains.log_joint.copy()
    density[1] -= 500.0
    data = to_arviz(replace(case.chains, log_joint=density), case.parameters, case.logs)
    write_report(data, tmp_path / "r.html")
    result = verdict(data)
    assert 'class="verdict bad"' in (tmp_path / "r.html").read_text(encoding="utf-8")
    text = read(tmp_path / "r.html").text
    shown = without_marks(" ".join(text))
    assert without_marks(result.message) in shown
    assert all(without_marks(line) in shown for line in result.advice)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("fits", [True, False])
def test_the_box_is_good_only_when_the_model_fits_as_well(tmp_path, report_data, fits):
    finding = {"name": "lasting", "log": 0, "message": "errors of ranges last about 3 s"}
    attrs = {
        "adequate": int(fits), "p_value": 0.5 if fits else 0.002, "readings": 239,
        "findings": json.dumps([] if fits else [finding]),
    }  # fmt: skip
    check = xr.Dataset({"residual_range": (("time", "beam"), np.zeros((60, 4)))}, attrs=attrs)
    write_report(extended(report_data, {"predictive_check": check}, {}), tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert ('class="verdict good"' in text) == fits
    assert ("readings and model disagree: errors of ranges last about 3 s" in text) == (not fits)


@pytest.mark.usefixtures("quick")
def test_each_log_is_shown_up_to_six(tmp_path):
    case = fake_case(n_draws=20, n_stored=2, n_logs=8)
    write_report(to_arviz(case.chains, case.parameters, case.logs), tmp_path / "r.html")
    text = " ".join(read(tmp_path / "r.html").text)
    assert "Log 5 of 8: made up" in text
    assert "Log 6 of 8" not in text
    assert "The other 2 logs are not shown." in text


def test_a_posterior_of_another_program_gets_a_page(tmp_path):
    draws = np.random.default_rng(0).normal(size=(4, 500))
    other = assemble({"posterior": xr.Dataset({"mu": (("chain", "draw"), draws)})}, {})
    write_report(other, tmp_path / "r.html")
    text = read(tmp_path / "r.html").text
    assert "mu" in text
    assert "MAP" not in text, "the joint mode with the path is not the mode of a parameter"


@pytest.mark.usefixtures("quick")
def test_an_old_page_survives_a_failure(report_data, tmp_path):
    with pytest.raises(PosteriorError, match="folder exists"):
        write_report(report_data, tmp_path / "nowhere" / "r.html")
    path = tmp_path / "r.html"
    path.write_text("old")
    empty = assemble({"posterior": xr.Dataset()}, {})
    with pytest.raises(PosteriorError):
        write_report(empty, path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_text_table_says_what_the_page_says(report_data):
    lines = summary_text(report_data).split("\n")
    columns = re.split(r"\s{2,}", lines[0].strip())
    assert columns == ["name", "unit", "mean", "sd", "90 % interval", "truth", "R-hat", "ESS"]
    assert len(lines) == 4
    cells = re.split(r"\s{2,}", lines[2])
    assert cells[:2] == ["sigma_turn", "rad"]
    assert float(cells[2]) == pytest.approx(0.02, abs=2e-4)
    assert float(cells[3]) == pytest.approx(0.001, rel=0.1)
    assert cells[5] == "0.01950"
    assert max(map(len, lines)) < 100
    assert "*" not in "".join(lines)


def test_rows_that_miss_a_limit_are_starred():
    case = fake_case(n_draws=500, correlation=0.0, truth=False)
    theta = case.chains.theta.copy()
    theta[0, :, 1] += 3.0 * SPREADS[1]
    lines = summary_text(to_arviz(replace(case.chains, theta=theta), case.parameters, case.logs)).split("\n")
    assert "truth" not in lines[0]
    assert [line.endswith("*") for line in lines] == [False, False, True, False]


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (0.0998489, 0.003987, "0.0998"),
        (0.0998489, 0.00987, "0.0998"),
        (12.345, 1.7, "12.3"),
        (1234.5, 170.0, "1234"),
        (-0.5, 0.03, "-0.500"),
        (3.21e-9, 4.5e-11, "3.210e-09"),
        (0.25, 0.0, "0.25"),
        (0.25, float("nan"), "0.25"),
        (float("nan"), 1.0, "-"),
        (float("inf"), 1.0, "inf"),
    ],
)
def test_rounding_keeps_two_digits_of_the_uncertainty(value, sd, text):
    assert rounded(value, sd) == text


class Judged(NamedTuple):
    """A verdict of two halves."""

    converged: bool
    adequate: bool | None
    message: str = "a sentence"
    advice: tuple[str, ...] = ("do this",)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("converged", "adequate", "box", "halves"),
    [
        (True, True, "good", ["✓ The chains have converged", "✓ The model fits the readings"]),
        (True, None, "unsure", ["✓ The chains have converged", "? Not checked whether the model fits"]),
        (True, False, "bad", ["✓ The chains have converged", "✗ The model does not fit"]),
        (False, True, "bad", ["✗ The chains have not converged", "✓ The model fits the readings"]),
    ],
)
def test_the_verdict_has_two_halves(report_data, tmp_path, monkeypatch, converged, adequate, box, halves):
    monkeypatch.setattr(posterior_report, "verdict", lambda data, summary: Judged(converged, adequate))
    write_report(report_data, tmp_path / "r.html")
    assert f'class="verdict {box}"' in (tmp_path / "r.html").read_text(encoding="utf-8")
    text = read(tmp_path / "r.html").text
    assert [line for line in text if line[0] in "✓✗?"] == halves
    assert text.index("do this") < text.index("Where the robot was")


@pytest.mark.usefixtures("quick")
def test_residuals_are_on_the_page_when_the_model_was_checked(report_data, tmp_path):
    groups = {name: find_group(report_data, name) for name in group_names(report_data)}
    scores = (("time", "beam"), np.random.default_rng(0).normal(size=(60, 4)))
    groups["predictive_check"] = xr.Dataset({"residual_range": scores}, {"time": groups["constant_data"]["time"]})
    write_report(assemble(groups, {}), tmp_path / "r.html")
    write_report(report_data, tmp_path / "unchecked.html")
    assert "Readings against predictions" in read(tmp_path / "r.html").text
    assert "Readings against predictions" not in read(tmp_path / "unchecked.html").text


def test_settings_are_explained_and_the_model_is_apart():
    table = settings_table({"zeta": 1.5, "model": "motion = 'increment'", "particles": 25, "log_fingerprint_1": "abc"})
    assert table.model == "motion = 'increment'"
    assert [row[:2] for row in table.rows] == [("particles", "25"), ("log_fingerprint_1", "abc"), ("zeta", "1.5")]
    assert [bool(meaning) for *_, meaning in table.rows] == [True, True, False]


def test_the_page_names_the_file_of_the_log_without_its_folder(report_case):
    log = SimpleNamespace(dataset=report_case.logs[0].dataset, true_theta=None, where="/home/someone/drives/monday.nc")
    observed, constant = log_groups([log])
    (summary,) = log_summaries(assemble({"observed_data": observed, "constant_data": constant}, {}))
    assert summary.robot == "robot-log0"
    assert summary.described == "monday.nc; made up; 60 rows over 30 s, 239 readings"
    assert summary.has_truth


def test_dollars_in_names_begin_no_formula(report_data, tmp_path):
    """Names of parameters come from files; a picture of the page shows them as they are."""
    old, name = "sigma_forward", "sigma_$x_{$"
    groups = {group: find_group(report_data, group) for group in group_names(report_data)}
    groups |= {group: groups[group].rename({old: name}) for group in groups if old in groups[group]}
    write_report(assemble(groups, {}), tmp_path / "page.html")
    assert name in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("stated", ["{", "[1, 2]", "[" * 99_999, [1, 2], '[{"name": "units"}]'])
def test_warnings_that_are_none_are_told(report_data, stated):
    with pytest.raises(PosteriorError, match="expected attribute preflight as JSON list of findings"):
        verdict(extended(report_data, {}, {"preflight": stated}))
