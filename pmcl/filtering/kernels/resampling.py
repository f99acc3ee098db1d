"""Resampling schemes: which particles become the parents of the next generation.

Multinomial is the paper's (Figure 1 there); systematic, stratified and residual keep the expected numbers
of children with less variance (Douc, Cappe, Moulines 2005). Weights that sum to a little less than one never lead
past the last particle of positive weight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pmcl.engine.compile import generic, kernel
from pmcl.engine.random_numbers import exponentials_into

__all__ = [
    "MULTINOMIAL",
    "RESIDUAL",
    "SCHEMES",
    "STRATIFIED",
    "SYSTEMATIC",
    "AnyScheme",
    "Independent",
    "cumulate",
    "draw_index",
    "draw_parents",
    "last_positive",
    "multinomial_into",
    "resample",
    "search",
]

MULTINOMIAL, SYSTEMATIC, STRATIFIED, RESIDUAL = 0, 1, 2, 3
SCHEMES = {"multinomial": MULTINOMIAL, "systematic": SYSTEMATIC, "stratified": STRATIFIED, "residual": RESIDUAL}


@kernel
def last_positive(weights):
    """Return the index of the last weight > 0, which a search by cumulated weights must never pass."""
    last = weights.size - 1
    while last > 0 and not weights[last] > 0.0:
        last -= 1
    return last


@kernel
def draw_index(weights, weight_sum, rng):
    """Draw one index with probability proportional to `weights` (n,), whose sum is `weight_sum`."""
    target = rng.random() * weight_sum
    cumulated = 0.0
    chosen = 0
    for i in range(weights.size):
        if weights[i] > 0.0:
            chosen = i
            cumulated += weights[i]
            if cumulated > target:
                break
    return chosen


@kernel
def cumulate(weights, cumulated):
    """Write the running sum of `weights` (n,) into `cumulated`."""
    value = 0.0
    for j in range(weights.size):
        value += weights[j]
        cumulated[j] = value


@kernel
def search(cumulated, rng):
    """Draw one index in O(log n), with probability proportional to the steps of `cumulated` (n,)."""
    low, high = 0, cumulated.size - 1
    target = rng.random() * cumulated[high]
    while low < high:
        middle = (low + high) // 2
        if cumulated[middle] > target:
            high = middle
        else:
            low = middle + 1
    while low > 0 and cumulated[low] == cumulated[low - 1]:  # where rounding led past the last positive weight
        low -= 1
    return low


@kernel
def _merge(weights, targets, first, ancestors, cumulated):
    """Find the particle whose share of the cumulated `weights` holds each of the ascending ``targets[first:]``.

    Each turn moves on in one of the two lists. In which is a coin that no processor can foresee, so it is arithmetic
    instead of a branch; unsigned, since for signed indices numba asks each time whether they are negative.
    """
    cumulate(weights, cumulated)
    cumulated[last_positive(weights)] = math.inf
    i, j, end = np.uint64(first), np.uint64(0), np.uint64(ancestors.size)
    while i < end:
        ancestors[i] = j
        behind = np.uint64(cumulated[j] <= targets[i])
        j += behind
        i += np.uint64(1) - behind


@kernel
def multinomial_into(weights, weight_sum, rng, first, ancestors, scratch):
    """Draw ``ancestors[first:]`` independently with probabilities proportional to `weights` (n,), in ascending order.

    Sorted uniforms come from normalised exponential spacings, so the cost is O(n). As a set the draws are i.i.d.;
    which slot holds which does not matter to particles that are exchangeable. `scratch` (2, n) is work space.
    """
    n, targets = ancestors.size, scratch[0]
    exponentials_into(rng, targets, scratch[1])
    value = -math.log(1.0 - rng.random())
    for i in range(first, n):
        spacing = targets[i]
        targets[i] = value
        value += spacing
    factor = weight_sum / value
    for i in range(first, n):
        targets[i] *= factor
    _merge(weights, targets, first, ancestors, scratch[1])


@kernel
def resample(scheme, weights, weight_sum, rng, ancestors, scratch):
    """Fill `ancestors` (m,) by one of the schemes; `scratch` (2, n) is work space, n >= m."""
    n, targets = ancestors.size, scratch[0]
    if scheme == MULTINOMIAL:
        multinomial_into(weights, weight_sum, rng, np.int64(0), ancestors, scratch)
        return
    if scheme == RESIDUAL:
        filled = 0
        residual_sum = 0.0
        for i in range(n):
            expected = n * weights[i] / weight_sum
            copies = int(expected)
            targets[i] = expected - copies
            residual_sum += targets[i]
            for _ in range(copies):
                if filled < n:
                    ancestors[filled] = i
                    filled += 1
        while filled < n:
            ancestors[filled] = (
                draw_index(targets, residual_sum, rng) if residual_sum > 0.0 else last_positive(weights)
            )
            filled += 1
        return
    step = weight_sum / n
    offset = rng.random()
    for i in range(n):
        if scheme == STRATIFIED:
            offset = rng.random()
        targets[i] = (i + offset) * step
    _merge(weights, targets, 0, ancestors, scratch[1])


class Independent(NamedTuple):
    """Parents from `first` on are drawn independently (multinomial resampling)."""

    first: int


class AnyScheme(NamedTuple):
    """Parents are drawn by the scheme of a number out of :data:`SCHEMES`, known only when the filter runs."""

    number: int


@generic
def draw_parents(scheme, weights, weight_sum, rng, ancestors, scratch):
    """Fill `ancestors` (n,) by a scheme. Its type decides what is compiled: sweeps need one scheme only."""


@draw_parents.register(Independent)
def _independent(scheme, weights, weight_sum, rng, ancestors, scratch):
    multinomial_into(weights, weight_sum, rng, scheme.first, ancestors, scratch)


@draw_parents.register(AnyScheme)
def _by_number(scheme, weights, weight_sum, rng, ancestors, scratch):
    resample(scheme.number, weights, weight_sum, rng, ancestors, scratch)
