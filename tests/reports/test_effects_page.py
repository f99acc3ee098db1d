"""The catalogue's page: every effect has a picture of what it does."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.effects.selection import effect_named
from pmcl.reports.effect_demonstrations import demonstrate
from pmcl.reports.effect_pictures import plot_effect
from pmcl.reports.effects_page import write_effects_page

# mypy: disable-error-code="no-untyped-def"


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_every_effect_changes_what_its_picture_shows(effect):
    drawn = plot_effect(effect)
    assert drawn is not None
    axes = drawn.figure.axes[0]
    assert axes.get_xlabel()
    assert axes.get_ylabel()
    assert len({text.get_text() for text in drawn.figure.legends[0].get_texts()}) >= 2
    assert effect.parameters[0].name in drawn.caption
    labels = {"odometry": "real path", "without": "with the effect"}
    lines = {line.get_label(): np.asarray(line.get_xydata(), dtype=float) for line in axes.get_lines()}
    without = next(lines[label] for label in labels if label in lines)
    affected = next(lines[label] for label in labels.values() if label in lines)
    assert without.shape == affected.shape
    share = np.nanmax(np.abs(affected - without), axis=0) / np.ptp(without[np.isfinite(without).all(axis=1)], axis=0)
    # On a map both coordinates count, else what is read.
    assert (share.max() if axes.get_xlabel() == "x [m]" else share[1]) > 0.03


def test_what_is_shown_is_the_effect_itself():
    shown = demonstrate(effect_named("range-bias"), quiet=True)
    assert shown is not None
    error = shown.affected.columns["range error"] - shown.without.columns["range error"]
    np.testing.assert_allclose(error, shown.values[0], atol=1e-9)
    shown = demonstrate(effect_named("odometry-forward-scale"), quiet=True)
    assert shown is not None
    ratio = shown.affected.columns["forward error"] / shown.affected.columns["step"]
    assert np.median(ratio) == pytest.approx(shown.values[0], abs=0.01)


def test_points_lie_on_the_walls_without_the_effect():
    shown = demonstrate(effect_named("sensor-yaw"), quiet=True)
    assert shown is not None
    x, y = shown.without.points.T
    on_wall = np.min([np.abs(x), np.abs(y), np.abs(x - 3.0), np.abs(y - 3.0), np.abs(x - 2.0), np.abs(y - 2.0)], axis=0)
    assert np.median(on_wall) < 0.002
    assert on_wall.max() < 0.05


def test_an_effect_without_typical_sizes_has_no_picture():
    assert plot_effect(replace(effect_named("range-bias"), typical={})) is None


def test_the_page_is_one_small_file(tmp_path):
    path = tmp_path / "effects.html"
    chosen = tuple(effect_named(name) for name in ("odometry-arc", "range-bias", "landmark-misread"))
    write_effects_page(path, chosen)
    text = path.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64") == len(chosen)
    assert not re.search(r"https?://|@import|url\(|<script|<link", text)
    # Three megabytes for the whole catalogue.
    assert len(text) / len(chosen) < 3e6 / len(CATALOGUE)
