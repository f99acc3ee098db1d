"""Terms of statistics, each explained on a page where it first appears.

The explanation stands below the paragraph, table or figure that uses the term first, so that it is there in print too.
"""

from __future__ import annotations

import html
import re
from html.parser import HTMLParser
from typing import NamedTuple

__all__ = ["TERMS", "Term", "explain_terms"]


class Term(NamedTuple):
    """A term that not every roboticist knows.

    Attributes
    ----------
    name : str
        The term as the explanation shows it.
    pattern : str
        Regular expression of the forms in which pages use it.
    explanation : str
        One or two sentences that use no other term of this list.
    """

    name: str
    pattern: str
    explanation: str


TERMS: tuple[Term, ...] = (
    Term(
        "R-hat",
        r"R[-‑]hat",
        "compares the spread between the chains with the spread within each chain. It is 1 when all chains sample the "
        "same distribution; above 1.01 they do not agree yet.",
    ),
    Term(
        "effective draws (ESS)",
        r"[Ee]ffective (?:draws|number of draws|sample sizes?)|\bESS\b",
        "successive draws resemble each other. The effective sample size is the number of independent draws that "
        "would estimate the mean (bulk) or the ends of the 90 % interval (tail) equally well.",
    ),
    Term(
        "MCSE",
        r"\bMCSE\b",
        "Monte Carlo standard error: how far the mean of the draws may be from the exact posterior mean, because there "
        "are only so many draws.",
    ),
    Term(
        "90 % interval",
        r"90 % interval",
        "given the log, the parameter lies in it with probability 90 %; 5 % lie below and 5 % above.",
    ),
    Term(
        "prior",
        r"\b[Pp]riors?\b",
        "the distribution of a parameter before the log was read.",
    ),
    Term(
        "posterior",
        r"\b[Pp]osteriors?\b",
        "the distribution of a parameter given everything in the log.",
    ),
    Term(
        "nat",
        r"\bnats?\b",
        "unit of differences between logarithms of probabilities, with the natural logarithm: 1 nat is a factor of "
        "2.72 in probability, 5 nats are a factor of 148.",
    ),
    Term(
        "PIT",
        r"\bPITs?\b|[Pp]robability integral transforms?",
        "probability integral transform: the probability that the model, before a reading came, gave to all smaller "
        "readings. For a model that fits, these numbers are spread evenly between 0 and 1.",
    ),
    Term(
        "normal score",
        r"[Nn]ormal scores?",
        "how far a reading is from its prediction one step ahead, in standard deviations of the prediction. For a "
        "model that fits, nine out of ten lie between -1.64 and 1.64.",
    ),
    Term(
        "residual",
        r"\b[Rr]esiduals?\b",
        "what was measured minus what the model expects.",
    ),
    Term(
        "log score",
        r"\b[Ll]og scores?\b",
        "logarithm of the probability density that the model gave to a reading before it came. Greater is better.",
    ),
    Term(
        "held out",
        r"\b[Hh]eld[- ]out\b",
        "a part of the log that was not used to fit the model, and that judges it.",
    ),
    Term(
        "p-value",
        r"\bp-values?\b",
        "how often chance alone, without any missing effect, gives a deviation that is at least as large.",
    ),
    Term(
        "90 % coverage",
        r"90 % coverage",
        "share of readings inside the 90 % interval that was predicted for them; 90 % is right, less means that the "
        "model is too sure.",
    ),
    Term(
        "log joint",
        r"\b[Ll]og joint\b",
        "logarithm of the joint probability density of parameters, path and readings.",
    ),
    Term(
        "burn-in",
        r"\b[Bb]urn-in\b",
        "the first part of each chain, in which it finds the posterior; its draws are not used.",
    ),
)
"""In the order of their use on a posterior's page."""

# Elements whose text is not running text, and elements that only contain others.
_SILENT = frozenset({"style", "title", "code", "pre", "abbr", "h1", "h2", "h3"})
_CONTAINERS = frozenset({"html", "head", "body", "main", "section"})
_VOID = frozenset({"meta", "link", "br", "hr", "img", "input", "wbr", "col"})


def explain_terms(text: str, terms: tuple[Term, ...] = TERMS) -> str:
    """Mark the first appearance of each term on a page, and explain it below the block that it appears in.

    Parameters
    ----------
    text : str
        A page (HTML).
    terms : tuple of Term
        The terms to explain.

    Returns
    -------
    str
        The page, otherwise unchanged.
    """
    writer = _Writer(terms)
    writer.feed(text)
    writer.close()
    return "".join(writer.written)


class _Occurrence(NamedTuple):
    """A term in a piece of text, from character `start` up to `end`."""

    start: int
    end: int
    term: Term



class _Writer(HTMLParser):
    """Copies the page that it parses, and adds marks and explanations."""

    def __init__(self, terms: tuple[Term, ...]) -> None:
        super().__init__(convert_charrefs=False)
        self.written: list[str] = []
        self._unseen = list(terms)
        self._pending: list[Term] = []
        self._open: list[str] = []

    def handle_decl(self, decl: str) -> None:
        self.written.append(f"<!{decl}>")

    def handle_comment(self, data: str) -> None:
        self.written.append(f"<!--{data}-->")

    def handle_entityref(self, name: str) -> None:
        self.written.append(f"&{name};")

    def handle_charref(self, name: str) -> None:
        self.written.append(f"&#{name};")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.written.append(self.get_starttag_text() or "")

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.written.append(self.get_starttag_text() or "")
        if tag not in _VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        self.written.append(f"</{tag}>")
        if tag in self._open:
            while self._open.pop() != tag:
                pass
        if all(name in _CONTAINERS for name in self._open):
            self._explain()

    def handle_data(self, data: str) -> None:
        silent = any(name in _SILENT for name in self._open)
        self.written.append(data if silent else self._marked(data))

    def _marked(self, data: str) -> str:
        occurrences: list[_Occurrence] = []
        for term in self._unseen:
            match = re.search(term.pattern, data)
            if match and not any(match.start() < end and start < match.end() for start, end, _ in occurrences):
                occurrences.append(_Occurrence(match.start(), match.end(), term))
        for start, end, term in sorted(occurrences, key=lambda occurrence: -occurrence.start):
            title = html.escape(term.explanation)
            data = f'{data[:start]}<abbr title="{title}">{data[start:end]}</abbr>{data[end:]}'
            self._unseen.remove(term)
        self._pending += [
            occurrence.term for occurrence in sorted(occurrences, key=lambda occurrence: occurrence.start)
        ]
        return data

    def _explain(self) -> None:
        if self._pending:
            items = "".join(
                f"<div><dt>{html.escape(term.name)}</dt> <dd>{html.escape(term.explanation)}</dd></div>"
                for term in self._pending
            )
            self.written.append(f'\n<dl class="terms">{items}</dl>')
            self._pending = []
