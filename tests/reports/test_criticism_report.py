"""The page about a criticism, looked at in a real browser."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from pmcl.criticism.findings.parts import Unexplained
from pmcl.criticism.workflow import criticize
from pmcl.models.effects.selection import effect_named
from pmcl.reports import criticism_figures as figures
from pmcl.reports.criticism_report import write_criticism_report
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


@pytest.fixture(scope="module")
def found():
    log = simulate_landmark_field(200, 3, bearings=True, effects=("landmark-range-bias=large",), hide_effects=True)
    # Some candidates of each carrier are enough for every part of the page.
    names = ("bearing-bias", "landmark-range-bias", "odometry-turn-bias", "odometry-forward-scale", "wheel-slip",
             "landmark-misread")  # fmt: skip
    offered = [effect_named(name, log) for name in names]
    return criticize(log, effects=offered, simulations=20, joint=False, rounds=1, seed=1)


@pytest.mark.slow
def test_every_figure_shows_before_and_after(found):
    assert found.effects
    assert [axes.get_title() for axes in figures.plot_map(found).axes[:2]] == ["before", "after"]
    heat = figures.plot_channels(found)
    labels = [text.get_text() for text in heat.axes[0].get_yticklabels()]
    assert any(label.startswith("landmark_bearing") for label in labels)
    assert len(figures.plot_pit(found).axes) == 2
    gains = figures.plot_gains(found).axes[0]
    assert found.effects[0].name in " ".join(text.get_text() for text in gains.get_yticklabels())
    bars = figures.plot_candidates(found).axes[0]
    assert len(bars.patches) >= 5
    assert "#009e73" in {figures_color(patch) for patch in bars.patches}


def figures_color(patch):
    return "#" + "".join(f"{round(255 * part):02x}" for part in patch.get_facecolor()[:3])


@pytest.mark.slow
def test_what_remains_has_an_interval_only_where_it_depends_on_something(found, tmp_path):
    nowhere = Unexplained("wheel-slip", (), "", "mean", (math.nan, math.nan), (380, 569), 1e-9)
    turning = Unexplained("landmark_bearing", (2,), "|turn|", "spread", (0.15, 0.41), (5, 180), 1e-9)
    write_criticism_report(replace(found, unexplained=(nowhere, turning)), tmp_path / "page.html")
    first, second = (tmp_path / "page.html").read_text().partition("What remains unexplained")[2].split("<tr>")[2:4]
    assert cells(first)[4:6] == ["-", "380 to 569"]
    assert cells(second)[4:6] == ["0.15 to 0.41", "5 to 180"]


def cells(row):
    return re.findall(r"<td[^>]*>(.*?)</td>", row)


@pytest.mark.parametrize(("verdict", "by_chance"), [("explained", True), ("unknown effect", False)])
def test_an_alarm_that_does_not_count_is_said_to_be_chance(found, tmp_path, verdict, by_chance):
    remains = Unexplained("wheel-slip", (), "", "mean", (math.nan, math.nan), (0, 10), 0.01)
    write_criticism_report(replace(found, verdict=verdict, unexplained=(remains,)), tmp_path / "page.html")
    assert ("chance is more probable" in (tmp_path / "page.html").read_text()) == by_chance



@pytest.mark.slow
def test_page_looks_right_in_a_browser(found, tmp_path):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine: the page is checked as text elsewhere")
    page, picture = tmp_path / "page.html", tmp_path / "page.png"
    write_criticism_report(found, page)
    subprocess.run(
        [
            browser, "--headless", "--hide-scrollbars", "--no-sandbox", "--disable-gpu", f"--screenshot={picture}",
            "--window-size=1050,3600", page.as_uri(),
        ],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape == (3600, 1050, 3)
    # The verdict's coloured box is at the top, text goes on to the bottom, and red and blue cells are between.
    box = np.array([0x00, 0x9E, 0x73] if found.verdict != "unknown effect" else [0xD5, 0x5E, 0x00]) / 255.0
    assert (np.abs(pixels[:400] - box).max(axis=-1) < 0.02).sum() > 200
    assert (pixels[-600:].min(axis=-1) < 0.5).sum() > 500
    red, blue = pixels[..., 0] - pixels[..., 2], pixels[..., 2] - pixels[..., 0]
    assert (red > 0.5).sum() > 300
    assert (blue > 0.3).sum() > 300
    # Nothing is wider than the window: the page ends in white at the right.
    assert pixels[:, -8:].mean() > 0.97
