"""Oracle of the spatial prior: its pooling in float64."""

from __future__ import annotations

import numpy as np

DETERMINED, FINEST = 0.25, 1 / 1024  # deviations, over a range: largest of a determined value, least


def taps(scales):
    """Return (n, 2) offsets (x, y): 5×5 without the centre, and the rim of 5×5 at every doubled distance."""
    grid = [(x, y) for x in range(-2, 3) for y in range(-2, 3) if (x, y) != (0, 0)]
    rims = [(x << s, y << s) for s in range(1, scales) for x, y in grid if max(abs(x), abs(y)) == 2]
    return np.array(grid + rims)


def around(shape, covered, row, column, scales):
    """Return rows and columns of the covered neighbours that a texel reads."""
    rows, columns = row + taps(scales)[:, 1], column + taps(scales)[:, 0]
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    rows, columns = rows[inside], columns[inside]
    there = covered[rows, columns]
    return rows[there], columns[there]


def components(model):
    """Return [(component, width of its range)] of all parameters except the normal."""
    of = [(p, model.offset(p.name)) for p in model.parameters if not p.is_normal]
    return [(at + i, p.range[1] - p.range[0]) for p, at in of for i in range(p.components)]


def similarity(prior, model, x, own, y, theirs):
    """Return (n,) similarity to a texel with values x and deviations own (C,) of neighbours with y, theirs (n, C)."""
    squared_distance = np.zeros(len(y))
    for p in model.parameters:
        if p.is_normal:
            continue
        at, width = model.offset(p.name), p.range[1] - p.range[0]
        for c in range(at, at + p.components):
            h = prior.bandwidth * width
            if p.components > 1:
                h = prior.color_bandwidth * np.maximum(abs(x[c]), abs(y[:, c])) + FINEST * width
            squared_distance += (x[c] - y[:, c]) ** 2 / (h**2 + own[c] ** 2 + theirs[:, c] ** 2)
    return np.exp(-squared_distance / 2)


def random_effects(s, y, sigma, least):
    """Return (mean, deviation) by DerSimonian & Laird of values y with deviations sigma, each counted s times."""
    w = 1 / sigma**2
    fixed = (s * w * y).sum() / (s * w).sum()
    q = (s * w * (y - fixed) ** 2).sum()
    left = (s * w).sum() - (s * w**2).sum() / (s * w).sum()
    between = max(least, (q - (s.sum() - 1)) / left if left > 0 else 0.0)
    w = 1 / (sigma**2 + between)
    return (s * w * y).sum() / (s * w).sum(), np.sqrt(between + 1 / (s * w).sum())


def pooled(prior, model, covered, estimates, own):
    """Return (H, W, C) means and deviations of the prior after all rounds; deviation 0 without a prior.

    estimates, own: (H, W, C) values and deviations from the samples.
    """
    belief, deviation = estimates.copy(), own.copy()
    for number in range(prior.rounds):
        last = number == prior.rounds - 1
        mean, spread = belief.copy(), np.zeros_like(deviation) if last else deviation.copy()
        for row, column in np.argwhere(covered):
            x, sigma = estimates[row, column], own[row, column]
            rows, columns = around(covered.shape, covered, row, column, prior.scales)
            y, theirs = belief[rows, columns], deviation[rows, columns]
            s = similarity(prior, model, x, sigma, y, theirs)
            for c, width in components(model):
                determined = theirs[:, c] < DETERMINED * width
                if s[determined].sum() <= 1e-6 or (not last and sigma[c] < DETERMINED * width):
                    continue
                fixed = np.maximum(theirs[determined, c], FINEST * width)
                mean[row, column, c], spread[row, column, c] = random_effects(
                    s[determined], y[determined, c], fixed, (prior.min_deviation * width) ** 2
                )
        belief, deviation = mean, spread
    return belief, deviation
