"""The settings of prefit, swarms and fitness: name, type, limits, label, help, default.

Every preset sets those without a default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .setting import MAX_ITERATIONS, MAX_STEPS, setting

Walls = Literal["clamp", "stop", "reflect"]
Loss = Literal["l1", "l2", "cauchy"]
SwarmStart = Literal["random", "lambert", "given"]
NormalSearch = Literal["hemisphere", "cartesian"]
Update = Literal["one", "all"]
LinearKind = Literal["search", "solve"]
_FACTOR = "FACTOR"

_UPDATE = {
    "one": ("One Particle", "An iteration moves one random particle of every swarm, as in the paper"),
    "all": ("Whole Swarm", "An iteration moves all particles"),
}
_LINEAR = {
    "search": ("Search", "The particles search albedo and weights like all other parameters"),
    "solve": ("Solve", "Albedo and weights are solved in closed form for every particle; Update must be Whole Swarm"),
}
_WALLS = {
    "clamp": ("Clamp", "A particle that would leave the range is put on its edge"),
    "stop": ("Stop", "A particle stops at the edge of the range and loses its speed"),
    "reflect": ("Reflect", "A particle bounces off the edge of the range"),
}
_STARTS = {
    "random": ("Random", "The first particles are spread at random over the whole range"),
    "lambert": (
        "Lambert",
        "A part of the first particles (Start Fraction) starts near a Lambertian fit of the photographs",
    ),
    "given": (
        "First Guess",
        "A part of the first particles (Start Fraction) starts near a first guess, which only scripts can give",
    ),
}
_NORMALS = {
    "hemisphere": ("Hemisphere", "A normal is two numbers on the hemisphere"),
    "cartesian": ("Cartesian", "A normal is three numbers that are normalized, as in the paper"),
}
_LOSSES = {
    "l1": ("Absolute", "Mean absolute difference, as in the paper"),
    "l2": ("Squared", "Mean squared difference: shadows and highlights have much influence"),
    "cauchy": ("Cauchy", "log(1 + (e/delta)²): differences well above Delta hardly count; best on photographs"),
}


@dataclass(frozen=True)
class Swarm:
    """The update of Eq. 2–4. Positions are in [0, 1], so a speed is a fraction of the parameter's range.

    inertia: Shi & Eberhart 1998. constriction: Clerc & Kennedy 2002.
    """

    update: Update = setting("Update", "Which particles of a swarm move in an iteration", choices=_UPDATE)
    linear: LinearKind = setting("Albedo", "How albedo and other linear weights are found", choices=_LINEAR)
    particles: int = setting(
        "Particles",
        "Least number of particles in each texel's swarm. More gives a surer result and takes longer",
        minimum=1,
        soft_max=64,
    )
    particles_per_dimension: float = setting(
        "Per Dimension",
        "Particles for each searched number, where this gives more than Particles",
        maximum=MAX_ITERATIONS,
        soft_max=8,
    )
    inertia: float = setting(
        "Inertia",
        "The part of its velocity that a particle keeps in the next iteration; 1 in the paper. Less settles sooner",
        soft_max=1,
    )
    constriction: float = setting(
        "Constriction",
        "Factor on a particle's new velocity; 1, as in the paper, changes nothing. Less settles sooner",
        soft_max=1,
    )
    c1: float = setting("Own Best", "c1 of Eq. 2: pull towards the particle's own best", soft_max=3)
    c2: float = setting("Swarm's Best", "c2 of Eq. 2: pull towards the best of the swarm", soft_max=3)
    c3: float = setting(
        "Neighbors", "c3 of Eq. 2: pull towards the mean of the neighboring texels' bests", soft_max=0.5
    )
    c3_fade: float = setting(
        "Neighbor Fade",
        "The part of the iterations in which c3 (Neighbors) falls to 0; 0 keeps c3 constant",
        maximum=1,
        subtype=_FACTOR,
    )
    neighbourhood: int = setting(
        "Window", "H of Eq. 4: side of the window of neighbors, in texels; odd", minimum=1, odd=True, maximum=255,
        soft_max=9, subtype="PIXEL",
    )  # fmt: skip
    neighbour_interval: int = setting(
        "Neighbor Interval", "Interval, in iterations, at which a particle tries the best result of a neighboring"
        " texel; 0 is never", soft_max=50,
    )  # fmt: skip
    v_max: float = setting(
        "Speed Limit", "Largest step, as a part of a parameter's range", exclusive_minimum=True, soft_max=1
    )
    walls: Walls = setting("Walls", "What happens to a particle that would leave the range", choices=_WALLS)
    start_speed: float = setting("Start Speed", "Largest first step, as a part of a parameter's range", soft_max=1)
    start: SwarmStart = setting("Start", "Where the first particles start", choices=_STARTS)
    start_fraction: float = setting(
        "Start Fraction",
        "The part of the swarm that starts near the Lambertian fit or the first guess; the rest starts at random",
        maximum=1,
        subtype=_FACTOR,
    )
    start_spread: float = setting(
        "Start Spread",
        "Largest distance of these particles from the fit or guess, as a part of a parameter's range",
        soft_max=0.5,
    )
    linear_limit: float = setting(
        "Albedo Limit", "Largest albedo that is searched, as a multiple of the texel's brightness; 0 searches the"
        " whole range", soft_max=32,
        precision=1,
    )  # fmt: skip
    normal: NormalSearch = setting("Normals", "How a normal is searched", choices=_NORMALS)


@dataclass(frozen=True)
class Fitness:
    """The objective of every phase: the mean loss over the observations of a texel, plus the model's priors.

    A texel's scale is a percentile of its radiance per light intensity; delta and shadow are fractions of this scale.
    Clipped samples are lower bounds (capture/bounds.py). Cauchy's loss is the Lorentzian of Black & Anandan 1996, The
    Robust Estimation of Multiple Motions, and α = 0 of Barron 2019, A General and Adaptive Robust Loss Function.
    """

    loss: Loss = setting("Loss", "How a difference between render and photograph counts", choices=_LOSSES)
    delta: float = setting(
        "Delta", "The difference beyond which a sample counts as an outlier, as a part of the texel's scale",
        minimum=1e-6, soft_max=0.5,
    )  # fmt: skip
    scale_percentile: float = setting(
        "Scale Percentile", "A texel's scale is this percentile of its radiances. Delta and Shadow are parts of the"
        " scale",
        exclusive_minimum=True, maximum=100, subtype="PERCENTAGE", precision=1,
    )  # fmt: skip
    shadow: float = setting(
        "Shadow", "Samples under this part of a texel's scale count as shadow (Cauchy loss only)", maximum=1
    )
    priors: bool = setting(
        "Model's Priors", "Use the model's priors for parameters that the photographs hardly determine"
    )
    clipped_samples: bool = setting(
        "Clipped Samples",
        "Use clipped samples as lower bounds: they count where the render is darker. Off: ignore them",
    )
    highlight_power: float = setting(
        "Highlights", "Above the texel's scale, Delta grows with this power of a sample's brightness. 0 keeps"
        " Delta constant (Cauchy loss only)",
        maximum=1, soft_max=1, precision=2,
    )  # fmt: skip


@dataclass(frozen=True)
class Prefit:
    """Normals before the stages, on grey samples, by a model of few assumptions (shaders/prefit/base_lobe.toml)."""

    iterations: int = setting(
        "Iterations",
        "Iterations of the swarms that find normals first; 0 for no prefit",
        0,
        maximum=MAX_ITERATIONS,
        soft_max=100,
    )
    refinement_iterations: int = setting(
        "Refinement", "Levenberg–Marquardt steps of the prefit, after its swarms", 5, maximum=MAX_STEPS, soft_max=30
    )
    shadow: float = setting("Shadow", "Samples under this part of a texel's scale count as shadow", 0.3, maximum=1)
    indirect_shadow: float = setting(
        "Shadow Where Indirect", "Where a texel has much indirect light, samples under this part of its scale"
        " count as shadow, and its normal is fitted again to the brighter samples. 0 is off", 0.0, maximum=1,
    )  # fmt: skip
    indirect_share: float = setting(
        "Least Indirect Share", "Subtract the light of other surfaces from texels where it is at least this part"
        " of their light. It is found by its color or in a texel's own shadows. 0 is off; needs Shadow Where"
        " Indirect", 0.0, maximum=1,
    )  # fmt: skip
    sheen_gain: float = setting(
        "Sheen Gain", "Where the prefit fits badly, try a second one with sheen, which is bright at grazing angles"
        " like velvet. A texel takes its normal if the misfit falls by this part or more. 0 is off", 0.0, soft_max=0.5,
    )  # fmt: skip
    min_observations: int = setting(
        "Fewest Photographs", "With fewer photographs than this there is no prefit", 10, soft_max=100
    )
    acceptance_delta: float = setting(
        "Acceptance Delta", "Delta of the loss that compares the prefit's normals with the model's, as a part of"
        " the texel's scale", 0.0125, exclusive_minimum=True,
        soft_max=0.5, precision=4,
    )  # fmt: skip
    acceptance_ratio: float = setting(
        "Acceptance Ratio", "A texel whose misfit after a refinement or the prior exceeds this many times the prefit's,"
        " plus 0.005, returns to its estimate from before that step", 1.2, soft_max=4,
    )  # fmt: skip


@dataclass(frozen=True)
class Stage:
    """Parameters searched together: names of parameters, or of stages in the model's table; "all" for every one."""

    search: tuple[str, ...]
    iterations: int = setting(
        "Iterations",
        "Iterations of every stage; 0 leaves them to the refinement",
        maximum=MAX_ITERATIONS,
        soft_max=5000,
    )
