"""One particle's step (rule.move) in the Python subset that numba compiles, for CPUs and CUDA."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from . import rule
from .functions import SCHWEFEL_VALUE

_SIDES = 2.0**-24  # spacing of the random numbers


def compiled(inline: Callable[[Callable], Any]) -> Any:
    """Return the compiled step(i, x, v, best, value, goal, first, seed, iteration, constants, number, reach).

    inline: compiler decorator of callable functions. The arrays are those of rule.Swarm; constants: (4,) inertia, c1,
    c2, v_max; number, reach: of a Function.
    """
    r1, r2 = np.uint32(rule.R1), np.uint32(rule.R2)
    u32 = np.uint32

    @inline
    def hashed(a, b, c, d):
        for _ in range(2):
            a = u32(a * u32(1664525) + u32(1013904223))
            b = u32(b * u32(1664525) + u32(1013904223))
            c = u32(c * u32(1664525) + u32(1013904223))
            d = u32(d * u32(1664525) + u32(1013904223))
            for turn in range(2):
                if turn == 1:
                    a = u32(a ^ (a >> u32(16)))
                    b = u32(b ^ (b >> u32(16)))
                    c = u32(c ^ (c >> u32(16)))
                    d = u32(d ^ (d >> u32(16)))
                a = u32(a + u32(b * d))
                b = u32(b + u32(c * a))
                c = u32(c + u32(a * b))
                d = u32(d + u32(b * c))
        return a, b, c, d

    @inline
    def lane(h, k):
        if k == 0:
            return (h[0] >> u32(8)) * _SIDES
        if k == 1:
            return (h[1] >> u32(8)) * _SIDES
        if k == 2:
            return (h[2] >> u32(8)) * _SIDES
        return (h[3] >> u32(8)) * _SIDES

    @inline
    def evaluate(x, i, number, reach):
        count = x.shape[1]
        total, product, before = 0.0, 1.0, 0.0
        for d in range(count):
            y = reach * (2.0 * x[i, d] - 1.0)
            if number == 0:
                total += y * y
            elif number == 1:
                if d > 0:
                    total += 100.0 * (y - before * before) ** 2 + (1.0 - before) ** 2
                before = y
            elif number == 2:
                total += y * y - 10.0 * math.cos(2.0 * math.pi * y) + 10.0
            elif number == 3:
                total += y * y
                product *= math.cos(y / math.sqrt(d + 1.0))
            elif number == 4:
                total += y * y
                before += math.cos(2.0 * math.pi * y)
            else:
                total += SCHWEFEL_VALUE - y * math.sin(math.sqrt(abs(y)))
        if number == 3:
            return total / 4000.0 - product + 1.0
        if number == 4:
            near = -20.0 * math.exp(-0.2 * math.sqrt(total / count))
            return near - math.exp(before / count) + 20.0 + math.e
        return total

    @inline
    def step(i, x, v, best, value, goal, first, seed, iteration, constants, number, reach):
        for block in range((x.shape[1] + 3) // 4):
            h1 = hashed(u32(first + i), u32(iteration), u32(4 * block) + r1, u32(seed))
            h2 = hashed(u32(first + i), u32(iteration), u32(4 * block) + r2, u32(seed))
            for k in range(min(4, x.shape[1] - 4 * block)):
                d = 4 * block + k
                pull = constants[1] * lane(h1, k) * (best[i, d] - x[i, d])
                pull = pull + constants[2] * lane(h2, k) * (goal[d] - x[i, d])
                speed = constants[0] * v[i, d] + pull
                speed = min(max(speed, -constants[3]), constants[3])
                target = x[i, d] + speed
                clamped = min(max(target, 0.0), 1.0)
                x[i, d] = clamped
                v[i, d] = speed if clamped == target else 0.0
        new_value = evaluate(x, i, number, reach)
        if new_value < value[i]:
            value[i] = new_value
            for d in range(x.shape[1]):
                best[i, d] = x[i, d]

    return step
