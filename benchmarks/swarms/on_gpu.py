"""A large swarm on the GPU by Blender's gpu module: passes over textures, single precision.

``every`` = 1 reduces all values to the least after every step, by a tree of passes; n > 1 does so every n steps, and
the particles meanwhile follow the previous global best.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from irpso_addon.gpu import context, textures
from irpso_addon.gpu.kernel import Kernel, Output
from irpso_addon.gpu.passes import Pass

from . import rule
from .functions import Function

_SIDE = 8  # a texel of the reduction tree reads _SIDE² texels
_HERE = Path(__file__).resolve().parent
_SAMPLERS = {name: "FLOAT_2D" for name in ("u_x", "u_v", "u_best", "u_goal", "u_value", "u_least", "u_from")}
_FLOATS = ("u_inertia", "u_c1", "u_c2", "u_v_max", "u_start_speed", "u_reach")
_CONSTANTS = {name: "FLOAT" for name in _FLOATS} | {n: "INT" for n in ("u_rows", "u_width", "u_iteration", "u_seed")}


class GpuSwarm:
    """A swarm on the GPU. entry: as for a Recovery. ``step`` returns before the GPU has finished, ``goal`` waits."""

    def __init__(
        self, constants: rule.Rule, function: Function, dimensions: int, particles: int, seed: int,
        entry: str = "fragment", every: int = 1,
    ):  # fmt: skip
        context.ensure()
        self._width = int(np.ceil(np.sqrt(particles)))
        self._rows = -(-particles // self._width)
        self._blocks, self._every, self._entry = -(-dimensions // 4), every, entry
        self._dimensions, self.iteration = dimensions, 0
        self._defines = {"DIMENSIONS": dimensions, "PARTICLES": particles, "FUNCTION": function.number, "SIDE": _SIDE}
        self._constants = {
            "u_inertia": constants.inertia, "u_c1": constants.c1, "u_c2": constants.c2, "u_v_max": constants.v_max,
            "u_start_speed": constants.start_speed, "u_reach": function.reach, "u_rows": self._rows,
            "u_width": self._width, "u_seed": seed,
        }  # fmt: skip
        four, one = Output("o_x"), Output("o_value", "R32F")
        least = Output("o_least", "R32F")
        self._move = self._pass("move", four, Output("o_v"))
        self._evaluate = self._pass("evaluate", one, least)
        self._keep = self._pass("keep", Output("o_best"))
        self._first, self._reduce = (self._pass("reduce", Output("o_least"), **d) for d in ({"FIRST": 1}, {}))
        self._aim = self._pass("aim", Output("o_goal"))
        self._allocate()
        self._place()

    def step(self, iterations: int = 1) -> None:
        """Run iterations."""
        for _ in range(iterations):
            self.iteration += 1
            self._run(self._move, [self._x[1], self._v[1]], u_x=self._x[0], u_v=self._v[0])
            self._x.reverse()
            self._v.reverse()
            self._run(self._evaluate, [self._value, self._least[1]], u_x=self._x[0], u_least=self._least[0])
            self._least.reverse()
            self._update_bests()
            if self.iteration % self._every == 0:
                self._update_goal()

    def goal(self) -> tuple[float, np.ndarray]:
        """Return the least value of any particle so far, and its position (D,) in 0…1 of the range."""
        self._update_goal()
        value = float(textures.download(self._tree[-1])[0, 0, 0])
        return value, textures.download(self._goal).ravel()[: self._dimensions]

    def best(self) -> np.ndarray:
        """Return (particles, D): the best position of each particle."""
        blocks = textures.download(self._best).reshape(self._blocks, -1, 4)
        return blocks.transpose(1, 0, 2).reshape(blocks.shape[1], -1)[: self._defines["PARTICLES"], : self._dimensions]

    def wait(self) -> None:
        """Wait until the GPU has finished."""
        self._aim.fence([self._goal])
        self._keep.fence([self._best])

    def _pass(self, name: str, *outputs: Output, **defines: Any) -> Pass:
        kernel = Kernel(_HERE / f"{name}.glsl", outputs, _SAMPLERS, _CONSTANTS, self._defines | defines)
        return Pass(kernel, self._entry)

    def _allocate(self) -> None:
        tall = self._rows * self._blocks
        self._x, self._v = ([textures.empty(self._width, tall) for _ in range(2)] for _ in range(2))
        self._best = textures.empty(self._width, tall)
        self._value = textures.empty(self._width, self._rows, "R32F")
        self._least = [textures.empty(self._width, self._rows, "R32F") for _ in range(2)]
        self._goal = textures.empty(self._blocks, 1, value=0.0)
        self._tree, size = [], (self._width, self._rows)
        while not self._tree or max(size) > 1:
            size = tuple(-(-side // _SIDE) for side in size)
            self._tree.append(textures.empty(*size))

    def _place(self) -> None:
        self._run(self._pass("move", Output("o_x"), Output("o_v"), START=1), [self._x[0], self._v[0]])
        begin = self._pass("evaluate", Output("o_value", "R32F"), Output("o_least", "R32F"), START=1)
        self._run(begin, [self._value, self._least[0]], u_x=self._x[0])
        self._update_bests()
        self._update_goal()

    def _update_bests(self) -> None:
        self._run(self._keep, [self._best], u_x=self._x[0], u_value=self._value, u_least=self._least[0])

    def _update_goal(self) -> None:
        self._run(self._first, [self._tree[0]], u_from=self._least[0])
        for before, after in zip(self._tree, self._tree[1:], strict=False):
            self._run(self._reduce, [after], u_from=before)
        self._run(self._aim, [self._goal], u_best=self._best, u_from=self._tree[-1])

    def _run(self, made: Pass, targets: list[Any], **inputs: Any) -> None:
        bindings = {"u_best": self._best, "u_goal": self._goal} | inputs
        made.run(targets, bindings, self._constants | {"u_iteration": self.iteration})
