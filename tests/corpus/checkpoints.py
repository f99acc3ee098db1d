"""Bad checkpoints of a run that is to go on."""

from __future__ import annotations

import h5py
from corpus.cases import EITHER, Case, cut, flipped
from corpus.logs import SPECIAL, deep, many, nested_raw, nested_virtual
from corpus.sound import Sound

FAMILY = "checkpoint"

RUN = ["--draws", 4, "--chains", 2, "--particles", 5, "--burn-in-particles", 5]

REFUSED = {
    "an external link": lambda file: file.__setitem__("main2", h5py.ExternalLink("/etc/passwd", "/")),
    "a virtual data set in a group": nested_virtual,
    "external raw storage in a group": nested_raw,
    "a soft link": lambda file: file.__setitem__("again", h5py.SoftLink("/")),
    "a group within itself": lambda file: file.create_group("g").__setitem__("again", file["/"]),
    "groups 200 deep": deep,
    "3000 arrays": many(3000),
    "10^12 cells declared": lambda file: file.create_dataset("big", (10**6, 10**6), "f8", chunks=(99, 99)),
    "another run": lambda file: file.attrs.__setitem__("pmcl_fingerprint", "0" * 64),
    "another version": lambda file: file.attrs.__setitem__("pmcl_checkpoint", 99),
    "a version of text": lambda file: file.attrs.__setitem__("pmcl_checkpoint", "new"),
    "a version of two": lambda file: file.attrs.__setitem__("pmcl_checkpoint", [3, 3]),
    "no version": lambda file: file.attrs.__delitem__("pmcl_checkpoint"),
}


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""

    def resuming(folder):
        return [
            "calibrate",
            sound.walls_log,
            "-o",
            folder / "out.nc",
            "--checkpoint",
            folder / "bad.h5",
            "--resume",
            *RUN,
        ]

    def rewritten(change):
        def make(folder):
            (folder / "bad.h5").write_bytes(sound.checkpoint.read_bytes())
            with h5py.File(folder / "bad.h5", "r+") as file:
                change(file)
            return resuming(folder)

        return make

    def damaged(change):
        def make(folder):
            (folder / "bad.h5").write_bytes(change(sound.checkpoint.read_bytes()))
            return resuming(folder)

        return make

    def special(create):
        def make(folder):
            create(folder / "bad.h5")
            return resuming(folder)

        return make

    found = [
        Case(FAMILY, name, rewritten(change), quick=name.startswith(("an ext", "ext", "a virt")))
        for name, change in REFUSED.items()
    ]
    found += [
        Case(FAMILY, name, special(create), quick=False)
        for name, create in SPECIAL.items()
        if name in ("a folder", "a pipe", "a device without end", "text")
    ]
    for k in (0, 3, 6, 8):
        found.append(Case(FAMILY, f"cut {k}", damaged(lambda content, k=k: cut(content, k)), quick=False))
    # In the head of the file stands which run it belongs to; flips elsewhere may be draws like others.
    for k in range(6):
        found.append(
            Case(
                FAMILY,
                f"flipped {k}",
                damaged(lambda content, k=k: flipped(content, 30, k, within=(0.0, 0.1))),
                EITHER,
                quick=False,
            )
        )
    return found


def warm(sound: Sound) -> list[list[object]]:
    """A run that goes on from a sound checkpoint, which is already complete."""
    return [
        [
            "calibrate",
            sound.walls_log,
            "-o",
            sound.folder / "warm_posterior.nc",
            "--checkpoint",
            sound.checkpoint,
            "--resume",
            *RUN,
        ]
    ]
