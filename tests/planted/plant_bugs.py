"""Plant bugs one by one in a copy of the sources, and see that the test that must catch each does.

Run it with ``python tests/planted/plant_bugs.py``; numbers of bugs after it plant only those. The result is written to
``results.csv`` beside this file, after each bug. The checkout itself is never changed.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).with_name("results.csv")


class Bug(NamedTuple):
    """What is wrong, the source, the text there and what takes its place, the test file and the test in it."""

    what: str
    source: str
    right: str
    wrong: str
    file: str
    test: str


_DIAGNOSTICS, _INDEPENDENCE = "posterior/diagnostics.py", "posterior/independence.py"
_VERDICT, _JUDGED = "posterior/test_independence.py", "posterior/test_diagnostics.py"
_FROZEN, _KILLED = "sampling/test_frozen_and_seeded.py", "sampling/test_killed_runs.py"
_STAGES, _TUNING = "calibration/particle_gibbs.py", "sampling/tuning.py"
_WHOLE, _HDF5, _GEOMETRY = "whole_file.py", "hdf5.py", "geometry.py"

BUGS = [
    Bug("R-hat without the last chain", _DIAGNOSTICS, "_each(r_hat, theta)", "_each(r_hat, theta[:-1])",
        _VERDICT, "test_each_chain_counts"),
    Bug("R-hat without the first chain", _DIAGNOSTICS, "_each(r_hat, theta)", "_each(r_hat, theta[1:])",
        _VERDICT, "test_each_chain_counts"),
    Bug("effective draws without a chain", _DIAGNOSTICS, "_each(bulk_ess, theta)", "_each(bulk_ess, theta[1:])",
        _VERDICT, "test_effective_draws_are_those_of_all_chains"),
    Bug("tails take the place of the bulk", _DIAGNOSTICS, "_each(bulk_ess, theta)", "_each(tail_ess, theta)",
        _VERDICT, "test_bulk_and_tail_measure_what_they_say"),
    Bug("the bulk takes the place of the tails", _DIAGNOSTICS, "_each(tail_ess, theta)", "_each(bulk_ess, theta)",
        _VERDICT, "test_bulk_and_tail_measure_what_they_say"),
    Bug("the verdict forgets the tails", _DIAGNOSTICS,
        'least = np.minimum(table["ess_bulk"].values, table["ess_tail"].values)', 'least = table["ess_bulk"].values',
        _VERDICT, "test_each_measure_of_each_parameter"),
    Bug("the verdict forgets the bulk", _DIAGNOSTICS,
        'least = np.minimum(table["ess_bulk"].values, table["ess_tail"].values)', 'least = table["ess_tail"].values',
        _VERDICT, "test_each_measure_of_each_parameter"),
    Bug("R-hat that is not a number passes", _DIAGNOSTICS, "if not score[index] <= 1.0]", "if score[index] > 1.0]",
        _VERDICT, "test_each_measure_of_each_parameter"),
    Bug("lost chains are never found", _DIAGNOSTICS, "_LOST_SPREADS = 5.0", "_LOST_SPREADS = 5000.0",
        _JUDGED, "test_a_lost_chain_prevents_convergence"),
    Bug("a lost chain does not count", _DIAGNOSTICS, "not (lost or short", "not (short",
        _JUDGED, "test_a_lost_chain_prevents_convergence"),
    Bug("standard errors as of independent draws", _DIAGNOSTICS, "_each(mcse_of_mean, theta)",
        "spread / np.sqrt(len(flat))", _JUDGED, "test_effective_draws_of_an_autoregressive"),
    Bug("copies of one chain are evidence", _INDEPENDENCE, "self.beginnings < 2", "self.beginnings < 1",
        _VERDICT, "test_copies_of_one_chain"),
    Bug("walkers of an ensemble are independent", _INDEPENDENCE, 'told.get("dependent_chains") is True', "False",
        _VERDICT, "test_walkers_of_an_ensemble"),
    Bug("tails of an ensemble are those of independent walkers", _DIAGNOSTICS,
        "np.fmin(tail, _each(ensemble_tail_ess, theta))", "tail", _VERDICT, "test_tails_of_an_ensemble"),
    Bug("dead sweeps are not counted", _INDEPENDENCE, "_DEAD_SHARE = 0.01", "_DEAD_SHARE = 2.0",
        _VERDICT, "test_sweeps_that_leave_the_path"),
    Bug("dead sweeps of a draw of several sweeps count double", _INDEPENDENCE, "(chains * draws * float(sweeps))",
        "(chains * draws)", _VERDICT, "test_sweeps_that_leave_the_path"),
    Bug("adaptation left on while drawing", _STAGES, "sweeps=self.sweeps_per_draw,\n        )",
        "sweeps=self.sweeps_per_draw,\n            gain=_GAIN,\n        )", _FROZEN, "test_nothing_adapts"),
    Bug("chains are restarted just before drawing", _STAGES, "restart_lost=number < rounds",
        "restart_lost=number <= rounds", _FROZEN, "test_chains_are_restarted_only"),
    Bug("the draws' own stage restarts chains", _STAGES, "window=0, restart_lost=False", "window=0, restart_lost=True",
        _FROZEN, "test_chains_are_restarted_only"),
    Bug("walkers share a seed", "sampling/walker_move.py", "int(seeds[k])", "int(seeds[0])",
        _FROZEN, "test_every_walker_of_every_step"),
    Bug("a walker gets another walker's path", "sampling/walker_move.py", "state.blobs[k], int", "state.blobs[0], int",
        _FROZEN, "test_every_walker_of_every_step"),
    Bug("chains share the seed of their beginning", "sampling/particle_gibbs.py", "[int(s) for s in seeds]",
        "[int(seeds[0]) for s in seeds]", _FROZEN, "test_every_chain_begins"),
    Bug("a restarted chain keeps its own path", _TUNING, "blobs=state.blobs[source].copy()",
        "blobs=state.blobs.copy()", _FROZEN, "test_a_restarted_chain_is_a_whole_copy"),
    Bug("a restarted chain keeps its old density", _TUNING, "log_prob=state.log_prob[source]",
        "log_prob=state.log_prob", _FROZEN, "test_a_restarted_chain_is_a_whole_copy"),
    Bug("lost chains are restarted from the worst", _TUNING, "best = int(np.argmax(", "best = int(np.argmin(",
        _FROZEN, "test_lost_chains_are_replaced"),
    Bug("lost chains are judged by steps before the window", _TUNING, 'blobs["log_evidence"][backend.window]',
        'blobs["log_evidence"][:3]', _FROZEN, "test_lost_chains_are_replaced"),
    Bug("the checkpoint is overwritten in its place", "sampling/checkpoint.py",
        "write_whole(self.path, content.getbuffer(), error=SamplingError)",
        "self.path.write_bytes(content.getbuffer())", _KILLED, "test_every_prefix_of_the_write_trace_holds"),
    Bug("a damaged checkpoint is read", "sampling/checkpoint.py", "if not head.whole:", "if False:",
        "sampling/test_resume.py", "test_every_changed_byte"),
    Bug("a resumed stage lacks a draw", "sampling/checkpoint.py",
        'backend.iteration = int(group.attrs["iteration"])', 'backend.iteration = int(group.attrs["iteration"]) - 1',
        _KILLED, "test_every_prefix_of_the_write_trace_holds"),
    Bug("another version of pmcl may resume", "sampling/checkpoint.py",
        "digest.update(f\"pmcl {version('pmcl')}\".encode())", "pass",
        "sampling/test_resume.py", "test_another_version_of_pmcl"),
    Bug("the code of effects is not part of a run", "sampling/checkpoint.py",
        "_digest_table(digest, table)\n    digest", "pass\n    digest",
        "sampling/test_resume.py", "test_another_version_of_pmcl"),
    Bug("a new name is not written to disk", _WHOLE, "            _keep_name(target.parent)\n", "",
        _KILLED, "test_a_new_name_is_written"),
    Bug("a file takes its place before it is written to disk", _WHOLE, "            os.fsync(stream.fileno())\n",
        "            pass\n", _KILLED, "test_a_new_name_is_written"),
    Bug("a failed write leaves its rest", _WHOLE, "            temporary.unlink()", "            pass",
        "test_whole_file.py", "test_an_error_leaves"),
    Bug("a link is replaced by a file", _WHOLE,
        "target = Path(os.path.realpath(path))\n    temporary", "target = Path(path)\n    temporary",
        "test_whole_file.py", "test_a_link_stays_a_link"),
    Bug("rests of other files are removed too", _WHOLE, '{glob.escape(target.name)}.*.part', '*.part',
        _KILLED, "test_what_a_killed_writer_left"),
    Bug("links to other files are followed", _HDF5, "if isinstance(link, h5py.ExternalLink):", "if False:",
        "test_hdf5.py", "test_"),
    Bug("virtual arrays are read", _HDF5, "if dataset.is_virtual:", "if False:", "test_hdf5.py", "test_"),
    Bug("raw data of other files are read", _HDF5, "if properties.get_external_count():", "if False:",
        "test_hdf5.py", "test_"),
    Bug("Ctrl-C is forgotten after the last step", "interrupts.py", "        yield\n        check_interrupt()\n",
        "        yield\n", "sampling/test_interrupts.py", "test_no_signal_is_lost"),
    Bug("the handler before is not put back", "interrupts.py",
        "            signal.signal(number, _PYTHONS_OWN[number])\n        _Watch.active",
        "            pass\n        _Watch.active",
        "sampling/test_interrupts.py", "test_the_handler_before"),
    Bug("a pool waits for a forked process that ignores its end", "interrupts.py",
        "        signal.signal(signal.SIGTERM, signal.SIG_DFL)\n", "        pass\n",
        "sampling/test_interrupts.py", "test_a_forked_process"),
    Bug("threads' errors are swallowed", "sampling/pool.py", "if error is not None:", "if False:",
        "sampling/test_pool.py", "test_an_error_ends_the_work"),
    Bug("threads work on after an error", "sampling/pool.py", "waiting.clear()", "pass",
        "sampling/test_pool.py", "test_an_error_ends_the_work"),
    Bug("values come in another order", "sampling/pool.py", "results[k] = function(item)",
        "results[-1 - k] = function(item)", "sampling/test_pool.py", "test_values_come_in_the_order"),
    Bug("poses are composed in the frame of the map", _GEOMETRY,
        "sine, cosine = np.sin(pose[..., 2]), np.cos(pose[..., 2])",
        "sine, cosine = 0.0 * pose[..., 2], np.ones_like(pose[..., 2])", "test_geometry.py", "test_compose_moves"),
    Bug("headings are subtracted the wrong way round", _GEOMETRY, "wrap(b[..., 2] - a[..., 2])",
        "wrap(a[..., 2] - b[..., 2])", "test_geometry.py", "test_between"),
    Bug("angles are averaged without their weights", _GEOMETRY, "(weight * np.sin(angles))", "(np.sin(angles))",
        "test_geometry.py", "test_circular_mean"),
    Bug("headings of kept trajectories are not wrapped", "posterior/convert.py",
        "poses[..., 2] = wrap(poses[..., 2])", "pass", "posterior/test_convert.py", "test_trajectory_has_its_own"),
    Bug("a truth on which logs differ is kept", "posterior/log_groups.py", "if len(values) == 1}", "}",
        "posterior/test_convert.py", "test_truth_on_which_logs_differ"),
    Bug("a rehearsal is skipped", "calibration/workflow.py",
        "    rehearse(bound.parameters, bound.logs, attributes, options.checkpoint)\n", "",
        "posterior/test_rehearsal.py", "test_calibrate_rehearses"),
    Bug("an error of the conversion loses the draws", "calibration/workflow.py",
        "nothing is lost, {kept}\",\n        result,", "nothing is lost, {kept}\",\n        None,",
        "posterior/test_rehearsal.py", "test_an_error_of_the_conversion"),
]  # fmt: skip


def planted(bug: Bug, root: Path = ROOT) -> str:
    """Return the source with the bug in it; the text that it replaces must be there exactly once."""
    text = (root / "pmcl" / bug.source).read_text()
    if text.count(bug.right) != 1:
        raise ValueError(f"{bug.what}: expected its text once in {bug.source}, got it {text.count(bug.right)} times")
    return text.replace(bug.right, bug.wrong)


def run(copy: Path, bug: Bug) -> int:
    """Run the test of a bug in the copy; return pytest's exit status."""
    done = subprocess.run(
        [sys.executable, "-B", "-m", "pytest", "-n", "0", "-x", "-p", "no:cacheprovider", f"tests/{bug.file}", "-k",
         bug.test],
        cwd=copy,
        env=os.environ | {"PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )  # fmt: skip
    return done.returncode


def main() -> int:
    """Plant the bugs; return how many survived."""
    chosen = [int(word) for word in sys.argv[1:]] or range(1, len(BUGS) + 1)
    rows = {}
    sound: dict[tuple[str, str], bool] = {}  # of each test: whether it passes with nothing planted
    if RESULTS.exists():
        with open(RESULTS, newline="") as stream:
            rows = {row["bug"]: row for row in csv.DictReader(stream)}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        ignored = shutil.ignore_patterns(".git", "__pycache__", "analyses")
        shutil.copytree(ROOT, copy, ignore=ignored)
        for number in chosen:
            bug = BUGS[number - 1]
            source = copy / "pmcl" / bug.source
            right = source.read_text()
            if (bug.file, bug.test) not in sound:
                sound[bug.file, bug.test] = run(copy, bug) == 0
            source.write_text(planted(bug))
            try:
                status = run(copy, bug)
            except subprocess.TimeoutExpired:
                status = 1
            finally:
                source.write_text(right)
            # 1: a test failed. Anything else, such as no test of that name, is no catch.
            outcome = {0: "survived", 1: "caught"}.get(status, f"pytest ended with status {status}")
            if not sound[bug.file, bug.test]:
                outcome = "its test fails without it too"
            test = f"{bug.file}::{bug.test}"
            rows[bug.what] = {"bug": bug.what, "source": bug.source, "test": test, "outcome": outcome}
            print(f"{number:3d} {outcome:9s} {bug.what}", flush=True)
            known = [rows[each.what] for each in BUGS if each.what in rows]
            with open(RESULTS, "w", newline="") as stream:
                writer = csv.DictWriter(stream, ["bug", "source", "test", "outcome"], lineterminator="\n")
                writer.writeheader()
                writer.writerows(known)
    return sum(row["outcome"] != "caught" for row in known)


if __name__ == "__main__":
    sys.exit(min(main(), 100))
