"""The notebook for beginners is whole: executed in order, without errors or warnings, and small."""

from __future__ import annotations

import ast
import json

import pytest
from docs.documents import README

NOTEBOOK = README.parent / "analyses" / "getting_started.ipynb"


@pytest.fixture(scope="module")
def cells():
    return [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]


def test_it_was_executed_in_order_without_errors(cells):
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    for cell in cells:
        for output in cell["outputs"]:
            assert output["output_type"] != "error"
            assert output.get("name") != "stderr", "".join(output["text"])
    assert NOTEBOOK.stat().st_size < 1_000_000


def test_what_it_imports_exists(cells):
    for cell in cells:
        source = "".join(line for line in cell["source"] if not line.startswith("%"))
        for node in ast.parse(source).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                exec(ast.unparse(node), {})
