from __future__ import annotations

import re

import pytest

from pmcl.reports.html import write_page
from pmcl.reports.terms import TERMS, explain_terms

# mypy: disable-error-code="no-untyped-def"


def test_a_term_is_explained_once_below_the_block_that_uses_it_first():
    text = "<body><h2>R-hat</h2><style>nat</style><div><p>One nat &amp; R-hat.</p></div><p>nat, R-hat</p></body>"
    page = explain_terms(text)
    assert page.count("<abbr") == 2
    first, rest = page.split('<dl class="terms">')
    assert first.startswith("<body><h2>R-hat</h2><style>nat</style><div><p>One <abbr")
    assert first.rstrip().endswith("</p></div>")
    assert rest.index("<dt>nat</dt>") < rest.index("<dt>R-hat</dt>") < rest.index("</dl><p>nat, R-hat</p></body>")
    assert "&amp;" in page


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_explanations_are_found_and_do_not_lean_on_other_terms(term):
    assert re.search(term.pattern, term.name)
    others = [other for other in TERMS if re.search(other.pattern, term.explanation) and other is not term]
    # Words of a definition may be terms themselves only where the definition says what they mean.
    assert {other.name for other in others} <= {"90 % interval", "posterior", "effective draws (ESS)"}


def test_nothing_else_changes():
    text = '<!DOCTYPE html>\n<body class="a"><!-- x --><img src="nat.png"><p>&lt;b&gt; &#39;5 %\n</p><br></body>\n'
    assert explain_terms(text) == text


def test_longer_words_are_left_alone():
    assert explain_terms("<p>PITCH, native, alternate priority</p>") == "<p>PITCH, native, alternate priority</p>"


def test_a_page_may_speak_of_a_file_whose_name_is_no_utf_8(tmp_path):
    write_page("<p>log\udcff.nc</p>", tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == "<p>log?.nc</p>"
