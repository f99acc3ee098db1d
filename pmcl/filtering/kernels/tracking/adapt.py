"""How many particles a belief needs (Fox 2003), and drawing that many from a weighted set."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.scalars import TURN
from pmcl.engine.views import columns
from pmcl.filtering.kernels.resampling import cumulate, draw_index, resample, search

__all__ = ["gather", "particles_needed", "redraw"]


@kernel
def particles_needed(occupied, error, quantile):
    """Return how many particles keep the sampled belief within `error` of the true one (Kullback-Leibler).

    Fox, Adapting the sample size in particle filters through KLD-sampling, IJRR 22(12), 2003, eq. 13: with `occupied`
    bins of the histogram, and the Wilson-Hilferty approximation of the chi-square quantile.
    """
    if occupied < 2:
        return 1
    k = occupied - 1.0
    a = 2.0 / (9.0 * k)
    return math.ceil(k / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3)


@kernel
def _bin_key(options, particles, i):
    """Return a number > 0 that names the bin of particle i: x and y, and the heading when states are poses."""
    size = particles.shape[0]
    key = 1
    for d in range(min(size, 3)):
        if d == 2:
            value = particles[2, i] - TURN * math.floor(particles[2, i] / TURN)
            cell = math.floor(value / options.bin_turn)
        else:
            cell = math.floor(particles[d, i] / options.bin_size)
        # Numbers below 2^20 per component, so that different bins of any floor have different keys.
        key = (key << 20) | (cell & 0xFFFFF)
    return key


@kernel
def _is_new(bins, key):
    """Put a key into the set `bins` (a power of two of places, 0 is empty); return whether it was not there."""
    mask = bins.size - 1
    place = (key * 0x9E3779B97F4A7C1 >> 17) & mask
    while bins[place] != 0:
        if bins[place] == key:
            return False
        place = (place + 1) & mask
    bins[place] = key
    return True


@kernel
def _adaptive(options, rng, particles, weights, ancestors, cumulated, bins):
    """Draw parents one by one until they are enough for the bins that they occupy; return how many."""
    cumulate(weights, cumulated)
    for b in range(bins.size):
        bins[b] = 0
    drawn, occupied, enough = 0, 0, options.least
    while drawn < enough:
        low = search(cumulated, rng)
        ancestors[drawn] = low
        drawn += 1
        if _is_new(bins, _bin_key(options, particles, low)):
            occupied += 1
            needed = particles_needed(occupied, options.kld_error, options.kld_quantile)
            enough = min(max(enough, needed), options.most)
    return drawn


@kernel
def gather(particles, ancestors, count, out, first):
    """Copy the columns of `particles` (D, n) that `ancestors` names into `out` (D, m) from column `first` on."""
    for d in range(particles.shape[0]):
        source, target = particles[d], out[d]
        for i in range(count):
            target[first + i] = source[ancestors[i]]


@kernel
def redraw(options, rng, state, size, n, weight_sum):
    """Resample the particles of `state` into ``state.before``; return their number, which may have changed."""
    particles, weights = columns(state.particles, size, n), state.weights[:n]
    if options.least < options.most:
        count = _adaptive(options, rng, particles, weights, state.ancestors, state.rate[:n], state.bins)
    else:
        count = options.most
        if count == n:
            resample(options.scheme, weights, weight_sum, rng, state.ancestors[:n], columns(state.rate, 2, n))
        else:
            for i in range(count):
                state.ancestors[i] = draw_index(weights, weight_sum, rng)
    gather(particles, state.ancestors, count, columns(state.before, size, count), 0)
    return count
