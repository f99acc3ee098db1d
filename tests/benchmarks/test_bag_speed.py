"""How long a bag takes to become a log, beside the time that it recorded; rosbags is imported before."""

from __future__ import annotations

import time

import pytest

from pmcl.logs.bags.read import read_bag

NAVIGATION, SECURITY = "/driver_laser_navigation/laser_scan", "/driver_laser_security/laser_scan"
JARVIS = "jarvis/jarvis_complex_path_fast.bag"
CASES = {
    "jarvis, one laser": (JARVIS, {"scans": [NAVIGATION], "truth": "/pose_ground_truth"}),
    "jarvis, all rays of both lasers": (
        JARVIS,
        {"scans": [NAVIGATION, SECURITY], "max_beams": None, "update_min_d": 0.0, "update_min_a": 0.0},
    ),
    "guardian, both lasers": ("guardian/guardian_3.bag", {"scans": ["/scan", "/hokuyo_back_scan"]}),
}


@pytest.mark.parametrize("name", CASES)
def test_bag_to_log(benchmark, shared_data, name):
    path, settings = CASES[name]
    log = read_bag(shared_data / path, **settings)
    before = time.process_time()
    benchmark.pedantic(read_bag, (shared_data / path,), settings, rounds=5, iterations=1)
    cpu = (time.process_time() - before) / 5
    recorded = float(log.times[-1] - log.times[0])
    benchmark.extra_info["times_real_time"] = recorded / cpu
    print(f"\n{name}: {cpu:.2f} s of CPU for {recorded:.0f} s, {recorded / cpu:.0f} x real time, {log.n_steps} rows")
