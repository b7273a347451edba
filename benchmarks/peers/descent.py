"""Gradient descent in PyTorch on all texels at once: Adam, PyTorch's L-BFGS, and L-BFGS with a line search a texel.

Gradients come from automatic differentiation of the model in ``models.py``; all parameters are unknown.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from .models import Geometry, radiance
from .objective import Loss, Objective
from .problem import PeerResult, Problem, Sample, peak_memory_mb

# A forward and a backward pass count as three renders, the least arithmetic of reverse differentiation. They take the
# time of 4.1 (two lobes) to 4.7 (principled) forward passes, so this favours the peer.
GRADIENT_EVALUATIONS = 3
FIRST_REACH = 0.1  # length of a first step along the gradient, in logits: about 2 % of the box
_STRAGGLERS = 0.02  # share of texels for which a line search does not continue; they retry in the next iteration
_EDGE = 1e-3  # least distance of a start from the walls of the box, where a sigmoid's slope is 0


class _Fit:
    """State of a descent: the problem's tensors, and each texel's best numbers and loss over all starts."""

    def __init__(self, problem: Problem, loss: Loss, dtype: torch.dtype, sigmoid: bool, device: str):
        self.objective, self.sigmoid, self.device, self.dtype = Objective(problem, loss), sigmoid, device, dtype
        o = self.objective
        self.target, self.gains, self.weights = (self.tensor(a) for a in (o.target, o.gains, o.weights[..., None]))
        g = o.geometry
        self.geometry = Geometry(*(self.tensor(a) for a in (g.lights, g.views, g.half, g.between)))
        self.evaluations, self.seconds, self.trace = 0, 0.0, []
        self.best = np.full(problem.count, np.inf)
        self.numbers = np.zeros((problem.count, o.box.size))

    def tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=self.dtype, device=self.device)

    def free(self, start: np.ndarray) -> torch.Tensor:
        """Return (T, size) free variables of numbers in the box."""
        x = self.tensor(start)
        return torch.logit(x, _EDGE) if self.sigmoid else x.clamp(_EDGE, 1 - _EDGE)

    def box(self, z: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(z) if self.sigmoid else z

    def losses(self, z: torch.Tensor) -> torch.Tensor:
        """Return (T,), the loss of every texel."""
        self.evaluations += 1
        values = self.objective.box.values(torch, self.box(z))
        diffuse, specular = radiance(torch, self.objective.problem.model, values, self.geometry)
        shown = diffuse[..., None] * values["base_color"] + specular[..., None]
        squared = self.weights * (shown * self.gains - self.target) ** 2
        if self.objective.loss.kind == "cauchy":
            squared = torch.log1p(squared / self.objective.loss.delta**2)
        return squared.sum((0, 2))

    def gradient(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return (T,) losses and (T, size) gradients."""
        z = z.detach().requires_grad_(True)
        losses = self.losses(z)
        (slope,) = torch.autograd.grad(losses.sum(), z)
        self.evaluations += GRADIENT_EVALUATIONS - 1
        return losses.detach(), torch.nan_to_num(slope)

    def keep(self, z: torch.Tensor) -> None:
        """Store the texels of z whose loss is below their best so far."""
        with torch.no_grad():
            losses = self.losses(z).double().cpu().numpy()
        better = losses < self.best
        self.best = np.where(better, losses, self.best)
        self.numbers[better] = self.box(z.detach()).double().cpu().numpy()[better]

    def values(self) -> dict[str, np.ndarray]:
        box = self.objective.box
        return box.ordered(box.values(np, np.clip(self.numbers, 0, 1)))


@dataclass
class _Clock:
    """Records the trace, and times the descent without the recording."""

    fit: _Fit
    every: int
    spent: float = 0.0
    iteration: int = 0

    def __call__(self, z: torch.Tensor) -> None:
        """Count an iteration; methods call this after each, with their free variables."""
        self.iteration += 1
        if self.every and self.iteration % self.every == 0:
            pause, evaluations = time.perf_counter(), self.fit.evaluations
            self.fit.keep(z)
            self.fit.evaluations = evaluations
            self.fit.trace.append(Sample(pause - self.fit.seconds - self.spent, evaluations, self.fit.values()))
            self.spent += time.perf_counter() - pause


Pair = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  # step, change of slope, 1 / their product
Step = Callable[[torch.Tensor], None]  # the clock


def adam(
    problem: Problem,
    loss: Loss = Loss(),  # noqa: B008
    iterations: int = 500,
    rate: float = 0.05,
    sigmoid: bool = False,
    **settings,
) -> PeerResult:
    """Adam (Kingma & Ba 2015), clamped to the box unless ``sigmoid``, its rate falling to a hundredth along a cosine.

    settings: those of ``_run``.
    """

    def descend(fit: _Fit, z: torch.Tensor, tick: Step) -> torch.Tensor:
        z.requires_grad_(True)
        optimizer = torch.optim.Adam([z], lr=rate, betas=(0.9, 0.99))
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, iterations, eta_min=rate / 100)
        for _ in range(iterations):
            _, z.grad = fit.gradient(z)
            optimizer.step()
            schedule.step()
            if not fit.sigmoid:
                z.data.clamp_(_EDGE, 1 - _EDGE)
            tick(z)
        return z.detach()

    return _run("Adam", problem, loss, descend, sigmoid, iterations=iterations, rate=rate, **settings)


def lbfgs(
    problem: Problem,
    loss: Loss = Loss(),  # noqa: B008
    iterations: int = 200,
    history: int = 20,
    **settings,
) -> PeerResult:
    """torch.optim.LBFGS with strong Wolfe search: one quadratic model and one step length for all texels together."""

    def descend(fit: _Fit, z: torch.Tensor, tick: Step) -> torch.Tensor:
        z.requires_grad_(True)
        optimizer = torch.optim.LBFGS(
            [z], lr=1.0, max_iter=1, max_eval=25, history_size=history, line_search_fn="strong_wolfe",
            tolerance_grad=0, tolerance_change=0,
        )  # fmt: skip

        def closure() -> torch.Tensor:
            losses, z.grad = fit.gradient(z)
            return losses.sum()

        for _ in range(iterations):
            optimizer.step(closure)
            tick(z)
        return z.detach()

    return _run("L-BFGS", problem, loss, descend, True, iterations=iterations, history=history, **settings)


def lbfgs_per_texel(
    problem: Problem,
    loss: Loss = Loss(),  # noqa: B008
    iterations: int = 150,
    history: int = 16,
    **settings,
) -> PeerResult:
    """L-BFGS (Nocedal & Wright 2006, Algorithm 7.4) with a quadratic model and an Armijo search per texel."""

    def descend(fit: _Fit, z: torch.Tensor, tick: Step) -> torch.Tensor:
        losses, slope = fit.gradient(z)
        pairs: list[Pair] = []
        done = torch.zeros_like(losses, dtype=torch.bool)
        scale = torch.zeros_like(losses)  # of the initial inverse Hessian; 0 where unknown
        for _ in range(iterations):
            fixed = scale > 0
            direction = _two_loops(slope, pairs, torch.where(fixed, scale, torch.ones_like(scale)))
            uphill = (direction * slope).sum(1) >= 0
            direction = torch.where(uphill[:, None], -slope, direction)
            reach = torch.where(fixed & ~uphill, 1.0, FIRST_REACH / direction.norm(dim=1).clamp_min(1e-12))
            step, losses, new_slope, failed = _search(fit, z, losses, slope, direction, reach, ~done)
            change = new_slope - slope
            curvature, steep = (step * change).sum(1), (change * change).sum(1)
            usable = curvature > 1e-8 * step.norm(dim=1) * steep.sqrt()
            inverse = torch.where(usable, 1 / torch.where(usable, curvature, 1.0), 0.0)
            # Where no step lowered the loss, the model is wrong: that texel restarts along its gradient.
            stuck = (step == 0).all(dim=1)
            done = done | (failed & ~fixed)
            scale = torch.where(usable, curvature / torch.where(usable, steep, 1.0), scale * ~stuck)
            pairs = [(s, y, i * ~stuck) for s, y, i in [*pairs, (step, change, inverse)][-history:]]
            z, slope = z + step, new_slope
            tick(z)
            if done.all():
                break
        return z

    return _run("L-BFGS a texel", problem, loss, descend, True, iterations=iterations, history=history, **settings)


METHODS = {"adam": adam, "l-bfgs": lbfgs, "l-bfgs per texel": lbfgs_per_texel}


def _run(
    name: str,
    problem: Problem,
    loss: Loss,
    descend: Callable[[_Fit, torch.Tensor, Step], torch.Tensor],
    sigmoid: bool = True,
    restarts: bool = True,
    dtype: torch.dtype = torch.float32,
    device: str = "cpu",
    threads: int = 0,
    trace_every: int = 10,
    **settings,
) -> PeerResult:
    """Descend from the seed and from each start; return each texel's best. trace_every: iterations; 0 for no trace.

    threads: of PyTorch; 0 for its default. On shared cores one is best: two, which synchronise at every operation, took
    twenty times as long.
    """
    if threads:
        torch.set_num_threads(threads)
    fit = _Fit(problem, loss, dtype, sigmoid, device)
    fit.seconds = time.perf_counter()
    clock = _Clock(fit, trace_every)
    for start in fit.objective.starts(restarts):
        z = descend(fit, fit.free(start), clock)
        fit.keep(z)
    seconds = time.perf_counter() - fit.seconds - clock.spent
    if trace_every:
        fit.trace.append(Sample(seconds, fit.evaluations, fit.values()))
    evaluations = np.full(problem.count, fit.evaluations)
    described = {"loss": loss, "restarts": restarts, "sigmoid": sigmoid, "dtype": str(dtype), **settings}
    described |= {"device": device, "threads": torch.get_num_threads()}
    return PeerResult(name, fit.values(), evaluations, seconds, peak_memory_mb(), described, tuple(fit.trace))


def _two_loops(slope: torch.Tensor, pairs: list[Pair], scale: torch.Tensor) -> torch.Tensor:
    """Return (T, size), −H g by the two-loop recursion. Pairs without curvature have a weight of 0."""
    q, shares = slope, []
    for step, change, inverse in reversed(pairs):
        share = inverse * (step * q).sum(1)
        q = q - share[:, None] * change
        shares.append(share)
    q = q * scale[:, None]
    for (step, change, inverse), share in zip(pairs, reversed(shares), strict=True):
        q = q + (share - inverse * (change * q).sum(1))[:, None] * step
    return -q


def _search(
    fit: _Fit,
    z: torch.Tensor,
    losses: torch.Tensor,
    slope: torch.Tensor,
    direction: torch.Tensor,
    reach: torch.Tensor,
    looking: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Armijo backtracking per texel: return step (0 where none succeeds), losses, slopes, and which texels failed.

    looking: (T,) bool, texels that search. The whole batch is rendered until nearly all have a step.
    """
    falls = (direction * slope).sum(1)
    step, new_losses, slopes = torch.zeros_like(z), losses, slope
    for _ in range(10):
        trial = torch.where(looking[:, None], reach[:, None] * direction, step)
        trial_losses, trial_slopes = fit.gradient(z + trial)
        good = looking & (trial_losses <= losses + 1e-4 * reach * falls)
        step = torch.where(good[:, None], trial, step)
        new_losses, slopes = (
            torch.where(good, trial_losses, new_losses),
            torch.where(good[:, None], trial_slopes, slopes),
        )
        looking = looking & ~good
        if looking.float().mean() < _STRAGGLERS:
            return step, new_losses, slopes, torch.zeros_like(looking)
        reach = reach * 0.35
    return step, new_losses, slopes, looking
