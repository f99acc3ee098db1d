"""Text tables: the bad line is named."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.errors import LogError
from pmcl.logs.text_table import read_table

COLUMNS = ("time", "x", "y")


def test_comments_and_empty_lines_are_skipped(tmp_path):
    (tmp_path / "a.dat").write_text("# time x y\n\n1 2\t3 # note\n  4   5e-1 -6\n")
    np.testing.assert_array_equal(read_table(tmp_path / "a.dat", COLUMNS), [[1.0, 2.0, 3.0], [4.0, 0.5, -6.0]])


def test_one_line_is_a_table(tmp_path):
    (tmp_path / "a.dat").write_text("1 2 3\n")
    assert read_table(tmp_path / "a.dat", COLUMNS).shape == (1, 3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("# c\n1 2 3\n4 five 6\n", "line 3: expected a finite number for x, got 'five'"),
        ("1 2 3\n4 5\n", r"line 2: expected 3 columns \(time, x, y\), got 2"),
        ("1 2 3 4\n", "line 1: expected 3 columns .* got 4"),
        ("1 2 3\n\n4 5 nan\n", "line 3: expected a finite number for y, got 'nan'"),
        ("1 2 3\ninf 5 6\n", "line 2: expected a finite number for time, got 'inf'"),
        ("", "the file is empty"),
        ("# only a comment\n", "the file is empty"),
        ("1,2,3\n", "line 1: expected 3 columns .* got 1"),
        ("\x00\xff\xfe 1 2\n", "line 1: expected a finite number for time"),
    ],
)
def test_a_bad_table_is_one_line_that_names_the_line(tmp_path, text, says):
    path = tmp_path / "a.dat"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(LogError, match=says) as caught:
        read_table(path, COLUMNS)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_table_is_one_line(tmp_path):
    with pytest.raises(LogError, match=r"absent.dat: expected a table of time, x, y, got no such file"):
        read_table(tmp_path / "absent.dat", COLUMNS)
