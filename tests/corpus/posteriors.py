"""Bad posteriors, and names in them that are hard to print."""

from __future__ import annotations

import h5py
import numpy as np
from corpus.cases import EITHER, Case, cut, drawn, flipped
from corpus.logs import SPECIAL, deep, many, nested_raw, nested_virtual
from corpus.sound import Sound
from hypothesis import strategies as st

FAMILY = "posterior"


def set_values(name, index, value):
    def change(file):
        values = file[name][...]
        values[index] = value
        file[name][...] = values

    return change


def set_attribute(name, value, group="/"):
    return lambda file: file[group].attrs.__setitem__(name, value)


def remove(*names):
    def change(file):
        for name in names:
            del file[name]

    return change


def renamed(old, new):
    return lambda file: file.move(old, new)


REFUSED = {
    "no posterior": remove("posterior"),
    "no draws in it": lambda file: [file["posterior"].__delitem__(name) for name in list(file["posterior"])
                                    if name.startswith("sigma")],
    "an external link": lambda file: file.__setitem__("posterior/other", h5py.ExternalLink("/etc/passwd", "/x")),
    "an external link in place of a group": lambda file: (
        file.__delitem__("prior"), file.__setitem__("prior", h5py.ExternalLink("/etc/passwd", "/"))),
    "a virtual data set in a group": nested_virtual,
    "external raw storage in a group": nested_raw,
    "a soft link": lambda file: file.__setitem__("posterior/again", h5py.SoftLink("/posterior/sigma_turn")),
    "a group within itself": lambda file: file.create_group("g").__setitem__("again", file["/"]),
    "groups 200 deep": deep,
    "3000 variables": many(3000),
    "10^12 cells declared": lambda file: file["posterior"].create_dataset("big", (10**6, 10**6), "f8", chunks=(99, 99)),
    "5e8 zeros, compressed": lambda file: file["posterior"].create_dataset(
        "big", (5 * 10**8,), "f8", chunks=(10**6,), compression="gzip"),
}  # fmt: skip

# Exporting as JSON uses the draws alone; localizing uses the model in the attributes as well.
EITHER_WAY = {
    "draws of nan": set_values("posterior/sigma_turn", slice(None), np.nan),
    "a draw of infinity": set_values("posterior/sigma_turn", (0, 3), np.inf),
    "draws of 1e308": set_values("posterior/sigma_turn", slice(None), 1e308),
    "draws below zero": set_values("posterior/sigma_turn", slice(None), -1.0),
    "draws of zero": set_values("posterior/sigma_turn", slice(None), 0.0),
    "log joint of nan": set_values("sample_stats/lp", slice(None), np.nan),
    "trajectories of nan": set_values("trajectories/trajectory", slice(None), np.nan),
    "model of nothing": set_attribute("model", ""),
    "model of numbers": set_attribute("model", [1.0, 2.0]),
    "model of Python": set_attribute("model", "__import__('os')"),
    "model of another sensor": set_attribute("model", "[sensors.sonar]\n"),
    "verdict of 60 kB": set_attribute("verdict", "x" * 60_000),
    "verdict of dollars": set_attribute("verdict", "$\\frac{$"),
    "converged of text": set_attribute("converged", "yes"),
    "preflight no JSON": set_attribute("preflight", "{"),
    "preflight of numbers": set_attribute("preflight", [1, 2]),
    "a parameter of dollars": renamed("posterior/sigma_turn", "posterior/$x_{$"),
    "a parameter of markup": renamed("posterior/sigma_turn", "posterior/<script>alert(1)<!script>"),
    "no warm-up": remove("sample_stats"),
    "no observed data": remove("observed_data"),
    "no constant data": remove("constant_data"),
    "no trajectories": remove("trajectories"),
    "no prior": remove("prior"),
    "a foreign group": lambda file: file.create_group("weather").create_dataset("wind", data=np.zeros(3)),
}

REPORTED = (
    "draws of nan",
    "model of numbers",
    "preflight no JSON",
    "a parameter of dollars",
    "a parameter of markup",
    "no constant data",
    "no trajectories",
)

_wild = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-320, 1e154, 1e308])
_change = st.tuples(
    st.sampled_from(["posterior/sigma_turn", "posterior/sigma_range", "sample_stats/lp", "trajectories/trajectory"]),
    st.integers(0, 10**6), _wild,
)  # fmt: skip


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""

    def exporting(folder):
        return ["export", folder / "bad.nc", "--format", "json", "-o", folder / "out.json"]

    def localizing(folder):
        return [
            "localize",
            sound.walls_log,
            "--posterior",
            folder / "bad.nc",
            "--particles",
            20,
            "-o",
            folder / "out.nc",
        ]

    def reporting(folder):
        return ["report", folder / "bad.nc", "-o", folder / "out.html"]

    def rewritten(change, command):
        def make(folder):
            (folder / "bad.nc").write_bytes(sound.posterior.read_bytes())
            with h5py.File(folder / "bad.nc", "r+") as file:
                change(file)
            return command(folder)

        return make

    def damaged(change, command):
        def make(folder):
            (folder / "bad.nc").write_bytes(change(sound.posterior.read_bytes()))
            return command(folder)

        return make

    def special(create):
        def make(folder):
            create(folder / "bad.nc")
            return exporting(folder)

        return make

    def of_log(folder):
        (folder / "bad.nc").write_bytes(sound.walls_log.read_bytes())
        return exporting(folder)

    found = [Case(FAMILY, name, rewritten(change, exporting)) for name, change in REFUSED.items()]
    found += [Case(FAMILY, name, special(create)) for name, create in SPECIAL.items()]
    found += [Case(FAMILY, "a log", of_log)]
    for name, change in EITHER_WAY.items():
        found.append(Case(FAMILY, name, rewritten(change, exporting), EITHER, follow=localizing, quick=False))
    # A report takes seconds of drawing.
    for name in REPORTED:
        found.append(Case(FAMILY, f"{name}, reported", rewritten(EITHER_WAY[name], reporting), EITHER,
                          quick=name == "a parameter of dollars"))  # fmt: skip
    for k in range(9):
        found.append(Case(FAMILY, f"cut {k}", damaged(lambda content, k=k: cut(content, k), exporting), quick=k == 6))
    for k in range(24):
        count = (1, 3, 30, 300)[k % 4]
        found.append(Case(FAMILY, f"{count} bits flipped, {k}", damaged(
            lambda content, c=count, k=k: flipped(content, c, k, within=(0.0, (1.0, 0.2)[k % 2])), exporting), EITHER,
            follow=localizing, quick=k < 2))  # fmt: skip
    for k, (name, place, value) in enumerate(drawn(_change, 20)):

        def change(file, name=name, place=place, value=value):
            values = file[name][...]
            values.flat[place % values.size] = value
            file[name][...] = values

        found.append(Case(FAMILY, f"{name} holds {value}, {k}", rewritten(change, localizing), EITHER, quick=k < 2))
    return found


def warm(sound: Sound) -> list[list[object]]:
    """Commands with a sound posterior."""
    return [
        ["export", sound.posterior, "--format", "json", "-o", sound.folder / "warm.json"],
        [
            "localize",
            sound.walls_log,
            "--posterior",
            sound.posterior,
            "--particles",
            20,
            "-o",
            sound.folder / "warm.nc",
        ],
        ["report", sound.posterior, "-o", sound.folder / "warm.html"],
    ]
