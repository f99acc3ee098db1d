"""A long search says what it is doing, and ends when somebody asks for it."""

from __future__ import annotations

import io
import logging
import time

import pytest

from pmcl.criticism import progress
from pmcl.criticism.progress import Progress
from pmcl.criticism.settings import Settings

# mypy: disable-error-code="no-untyped-def"


def settings(reporter, workers=2):
    return Settings(300, 1, 0.05, 20, 10, workers, False, reporter=reporter)


def test_off_a_terminal_lines_say_what_is_done_what_is_left_and_the_time(caplog):
    caplog.set_level(logging.INFO, logger="pmcl.criticism")
    with Progress(True, live=False, pause=0.02) as reporter:
        run = settings(reporter, workers=1)
        run.tell("an alarm", "looking for its cause")
        values = run.mapped(lambda k: time.sleep(0.05) or k, "longer fits of candidates", ["beam-bias", "arc", "bias"])
        time.sleep(0.05)
    assert values == [0, 1, 2]
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "[0:00] an alarm"
    assert "[0:00] longer fits of candidates: 1 of 3 done, 2 left, now arc" in lines
    # After the pieces the step itself goes on.
    assert lines[-1] == "[0:00] still looking for its cause"
    count = len(lines)
    time.sleep(0.05)
    assert len(caplog.records) == count


def test_nothing_is_told_unless_asked_for(caplog):
    caplog.set_level(logging.INFO, logger="pmcl.criticism")
    with Progress(False, pause=0.01) as reporter:
        reporter.tell("refitting")
        time.sleep(0.03)
    assert not caplog.records


def test_on_a_terminal_one_line_is_kept_up_to_date(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr("sys.stderr", screen)
    names = ["beam-bias", "arc"]
    with Progress(True, live=True) as reporter, reporter.watched("longer fits of candidates", names) as watch:
        watch.begin(0)
        reporter._show()
        watch.end()
        watch.begin(1)
        reporter._show()
        with reporter.paused():
            before = screen.getvalue()
            reporter._show()
            assert screen.getvalue() == before
    text = screen.getvalue()
    assert "[0:00] longer fits of candidates: 0 of 2 done, 2 left, now beam-bias" in text
    assert "[0:00] longer fits of candidates: 1 of 2 done, 1 left, now arc" in text
    assert "\n" not in text


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interruption_ends_the_work_before_the_next_piece(workers, monkeypatch):
    done = []

    def interrupted():
        if len(done) >= 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(progress, "check_interrupt", interrupted)
    with Progress(False) as reporter:

        def piece(k):
            done.append(k)
            time.sleep(0.01)

        with pytest.raises(KeyboardInterrupt):
            settings(reporter, workers).mapped(piece, "refitting", [""] * 50)
        with pytest.raises(KeyboardInterrupt):
            reporter.tell("the next step")
    assert len(done) <= 2 + workers


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_is_told_and_ends_the_other_pieces(workers):
    done = []

    def piece(k):
        done.append(k)
        time.sleep(0.01)
        if k == 1:
            raise ValueError("no")

    with Progress() as reporter, pytest.raises(ValueError, match="no"):
        settings(reporter, workers).mapped(piece, "refitting", [""] * 50)
    assert len(done) < 10
