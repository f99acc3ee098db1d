"""``pmcl identify``, from files to a page."""

from __future__ import annotations

import pmcl


def test_it_prints_the_table_and_writes_a_page(run, tmp_path):
    log = tmp_path / "log.nc"
    pmcl.simulate_aibo(60.0, 4).write(log)
    page = tmp_path / "page.html"
    result = run("identify", log, "-o", page)
    assert result.exit_code == 0, result.output
    for name in ("sigma_forward", "sigma_left", "sigma_turn", "sigma_bearing", "sigma_size"):
        assert name in result.stdout
        assert name in page.read_text()
    assert f"report: {page}" in result.stdout
    without = run("identify", log, "--no-drives")
    assert without.exit_code == 0
    assert "report:" not in without.stdout
    assert "This log can tell" in without.stdout


def test_bad_input_is_one_line(run, tmp_path):
    log = tmp_path / "log.nc"
    pmcl.simulate_aibo(30.0, 4).write(log)
    model = tmp_path / "model.toml"
    names = ("sigma_forward", "sigma_left", "sigma_turn", "sigma_bearing", "sigma_size")
    model.write_text("[fixed]\n" + "".join(f"{name} = 0.05\n" for name in names))
    one_row = tmp_path / "one.nc"
    pmcl.read_log(log).select(0, 1).write(one_row)
    cases = {
        "no free parameter": ("identify", log, "--model", model),
        "two rows": ("identify", one_row),
        "missing": ("identify", tmp_path / "missing.nc"),
        "input": ("identify", log, "-o", log),
        "map": ("identify", log, "--map", tmp_path / "missing.yaml"),
    }
    for name, arguments in cases.items():
        result = run(*arguments)
        assert result.exit_code == 2, name
        assert result.stderr.startswith("pmcl: error: "), name
        assert result.stderr.count("\n") == 1, name
    assert "free one" in run(*cases["no free parameter"]).stderr
