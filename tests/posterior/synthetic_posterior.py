"""Chains, parameters and logs made up for tests, with known properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from scipy import stats

from pmcl.sampling.chains import Chains

NAMES = ("sigma_forward", "sigma_turn", "sigma_range")
UNITS = ("m", "rad", "m")
CENTRES = np.array([0.03, 0.02, 0.10])
SPREADS = np.array([0.002, 0.001, 0.004])
TRUTH = {"sigma_forward": 0.031, "sigma_turn": 0.0195, "sigma_range": 0.098}
ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [3.5, 4.0], [3.5, 3.0], [0.0, 3.0]])


@dataclass(frozen=True)
class FakeParameter:
    name: str
    unit: str
    prior: object
    description: str


@dataclass(frozen=True)
class FakeLog:
    dataset: xr.Dataset
    true_theta: Mapping[str, float] | None = None
    label: str = "abc"

    def fingerprint(self) -> str:
        return f"hash-{self.label}"


@dataclass(frozen=True)
class Case:
    """One call of the converter."""

    chains: Chains
    parameters: list[FakeParameter]
    logs: list[FakeLog] = field(default_factory=list)


def fake_parameters(names=NAMES, units=UNITS):
    return [
        FakeParameter(name, unit, stats.gamma(2.0, scale=0.05), f"noise {name} of the <model>")
        for name, unit in zip(names, units, strict=True)
    ]


def true_path(n_steps):
    """A loop through the room whose heading passes pi more than once."""
    angle = np.linspace(0.0, 4.0 * np.pi, n_steps)
    return np.column_stack([3.0 + 1.8 * np.cos(angle), 1.6 + 0.9 * np.sin(angle), angle + np.pi / 2.0])


def fake_log(n_steps=60, n_beams=4, *, landmarks=False, truth=True, label="abc"):
    rng = np.random.default_rng(7)
    path = true_path(n_steps)
    variables = {
        "odometry": (("time", "increment"), rng.normal(size=(n_steps, 3))),
        "start_mean": ("pose", path[0]),
        "start_std": ("pose", np.array([np.inf, np.inf, np.inf])),
    }
    if landmarks:
        variables["landmark_range"] = (("time", "landmark"), rng.uniform(1.0, 4.0, size=(n_steps, 5)))
        variables["landmark_position"] = (("landmark", "xy"), rng.uniform(0.0, 4.0, size=(5, 2)))
    else:
        walls = np.stack([ROOM, np.roll(ROOM, -1, axis=0)], axis=1)
        readings = rng.uniform(0.5, 3.0, size=(n_steps, n_beams))
        readings[3, 1], readings[4, 2] = np.nan, np.inf
        variables["range"] = (("time", "beam"), readings, {"max_range": 5.0})
        variables["beam_pose"] = (("beam", "pose"), rng.normal(size=(n_beams, 3)))
        variables["wall"] = (("wall_index", "end", "xy"), walls)
    if truth:
        variables["true_pose"] = (("time", "pose"), path)
    coords = {"time": 0.5 * np.arange(n_steps), "increment": ["forward", "left", "turn"]}
    attrs = {"format": "pmcl-log/1", "robot": f"robot-{label}", "source": "made up"}
    return FakeLog(xr.Dataset(variables, coords=coords, attrs=attrs), dict(TRUTH) if truth else None, label)


def autoregressive(rng, n_chains, n_draws, n_dim, correlation):
    """Stationary standard normal draws with the given correlation from one to the next."""
    noise = rng.normal(size=(n_chains, n_draws, n_dim))
    out = np.empty_like(noise)
    out[:, 0] = noise[:, 0]
    for draw in range(1, n_draws):
        out[:, draw] = correlation * out[:, draw - 1] + np.sqrt(1.0 - correlation**2) * noise[:, draw]
    return out


def fake_case(
    *,
    n_chains=4,
    n_draws=1000,
    n_stored=10,
    n_logs=1,
    warmup=100,
    correlation=0.3,
    seed=1,
    n_states=3,
    landmarks=False,
    truth=True,
):
    rng = np.random.default_rng(seed)
    normal = autoregressive(rng, n_chains, n_draws, len(NAMES), correlation)
    theta = CENTRES + SPREADS * normal
    log_joint = -900.0 - 0.5 * (normal**2).sum(axis=-1) + rng.normal(scale=6.0, size=(n_chains, n_draws))
    logs = [fake_log(60 + 10 * index, landmarks=landmarks, truth=truth, label=f"log{index}") for index in range(n_logs)]
    trajectories = []
    for log in logs:
        n_steps = log.dataset.sizes["time"]
        path = np.concatenate([true_path(n_steps), np.zeros((n_steps, n_states - 3))], axis=1)
        noise = 0.02 * autoregressive(rng, n_chains * n_stored, n_steps, n_states, 0.9)
        trajectories.append(path + noise.reshape(n_chains, n_stored, n_steps, n_states))
    scatter = 1.0 + 0.3 * rng.normal(size=(n_chains, warmup, len(NAMES)))
    chains = Chains(
        names=NAMES,
        units=UNITS,
        theta=theta,
        log_joint=log_joint,
        statistics={
            "acceptance_rate": (rng.random(theta.shape) < 0.4).astype(float),
            "path_update_rate": rng.uniform(0.8, 1.0, size=log_joint.shape),
            "particle_ess": rng.uniform(10.0, 20.0, size=log_joint.shape),
        },
        trajectories=tuple(trajectories),
        trajectory_draw=np.linspace(0, n_draws - 1, n_stored).astype(np.int64),
        warmup_theta=CENTRES * scatter,
        warmup_log_joint=rng.normal(-950.0, 10.0, size=(n_chains, warmup)),
        settings={"particles": 25, "kernel": "conditional", "seed": 2**80 + 1, "resumed": False, "data_rate": 0.5},
    )
    return Case(chains, fake_parameters(), logs)
