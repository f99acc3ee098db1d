"""``pmcl compare``: from a log to a page, and what it refuses."""

from __future__ import annotations


def test_compare_writes_a_page_and_prints_a_table(run, log_file, tmp_path):
    output = tmp_path / "page.html"
    output.write_text("older")
    result = run(
        "compare", log_file, "--methods", "conditional:8,plain:8", "-o", output, "--seconds", "0.5", "--chains", "2"
    )
    # So little time may or may not be enough for the reference.
    assert result.exit_code in (0, 3), result.output
    assert (result.exit_code == 3) == ("The reference has not converged" in result.stdout)
    assert result.stdout.splitlines()[0].split()[0] == "method"
    assert f"report: {output}" in result.stdout
    page = output.read_text()
    assert "older" not in page
    for name in ("conditional:8", "plain:8"):
        assert name in page
        assert name in result.stdout


def test_what_compare_refuses(refused, log_file, tmp_path):
    output = tmp_path / "page.html"
    output.write_text("older")
    assert "did you mean 'smoothing'" in refused("compare", log_file, "--methods", "smothing", "-o", output)
    assert "at least 2" in refused("compare", log_file, "--methods", "plain:1", "-o", output)
    assert "'--seconds'" in refused("compare", log_file, "-o", output, "--seconds", "0")
    assert "'--chains'" in refused("compare", log_file, "-o", output, "--chains", "1")
    assert "other than the input" in refused("compare", log_file, "-o", log_file)
    assert "no such file" in refused("compare", tmp_path / "none.nc", "-o", output)
    assert "no folder" in refused("compare", log_file, "-o", tmp_path / "nowhere" / "x.html")
    assert output.read_text() == "older"
