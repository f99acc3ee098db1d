"""Resampling schemes: which particles become the parents of the next generation.

Multinomial is the paper's (Figure 1 there); systematic, stratified and residual keep the expected numbers
of children with less variance (Douc, Cappe, Moulines 2005). Weights that sum to a little less than one never lead
past the last particle of positive weight.
"""

from __future__ import annotations

from pmcl.filtering.kernels.compile import kernel

__all__ = [
    "MULTINOMIAL",
    "RESIDUAL",
    "SCHEMES",
    "STRATIFIED",
    "SYSTEMATIC",
    "draw_index",
    "last_positive",
    "multinomial_into",
    "resample",
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
def multinomial_into(weights, weight_sum, rng, first, ancestors, spacings):
    """Draw ``ancestors[first:]`` independently with probabilities proportional to `weights` (n,), in ascending order.

    Sorted uniforms come from normalised exponential spacings, so the cost is O(n). As a set the draws are i.i.d.;
    which slot holds which does not matter to particles that are exchangeable.
    """
    n = ancestors.size
    sum_of_spacings = rng.standard_exponential()
    for i in range(first, n):
        spacings[i] = sum_of_spacings
        sum_of_spacings += rng.standard_exponential()
    factor = weight_sum / sum_of_spacings
    last = last_positive(weights)
    j = 0
    cumulated = weights[0]
    for i in range(first, n):
        target = spacings[i] * factor
        while cumulated <= target and j < last:
            j += 1
            cumulated += weights[j]
        ancestors[i] = j


@kernel
def resample(scheme, weights, weight_sum, rng, ancestors, scratch):
    """Fill `ancestors` (n,) by one of the schemes; `scratch` (n,) is work space."""
    n = ancestors.size
    if scheme == MULTINOMIAL:
        multinomial_into(weights, weight_sum, rng, 0, ancestors, scratch)
        return
    if scheme == RESIDUAL:
        filled = 0
        residual_sum = 0.0
        for i in range(n):
            expected = n * weights[i] / weight_sum
            copies = int(expected)
            scratch[i] = expected - copies
            residual_sum += scratch[i]
            for _ in range(copies):
                if filled < n:
                    ancestors[filled] = i
                    filled += 1
        while filled < n:
            ancestors[filled] = (
                draw_index(scratch, residual_sum, rng) if residual_sum > 0.0 else last_positive(weights)
            )
            filled += 1
        return
    last = last_positive(weights)
    step = weight_sum / n
    offset = rng.random()
    j = 0
    cumulated = weights[0]
    for i in range(n):
        if scheme == STRATIFIED:
            offset = rng.random()
        target = (i + offset) * step
        while cumulated <= target and j < last:
            j += 1
            cumulated += weights[j]
        ancestors[i] = j
