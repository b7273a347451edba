"""The settings of each phase: name, type, limits, label, help, default. Every preset sets those without one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .setting import setting

Walls = Literal["clamp", "stop", "reflect"]
Loss = Literal["l1", "l2", "robust"]
Seed = Literal["random", "lambert", "given"]
NormalSearch = Literal["hemisphere", "cartesian"]
Update = Literal["one", "all"]
LinearKind = Literal["search", "solve"]
_FACTOR = "FACTOR"

_UPDATE = {
    "one": ("One Particle", "An iteration moves one random particle of every swarm, as in the paper"),
    "all": ("Whole Swarm", "An iteration moves all particles"),
}
_LINEAR = {
    "search": ("Search", "Albedo and weights are searched like everything else"),
    "solve": (
        "Solve",
        "Albedo and weights are solved in closed form for every particle; needs Update of the whole swarm",
    ),
}
_WALLS = {
    "clamp": ("Clamp", "A particle that would leave the range is put on its edge"),
    "stop": ("Stop", "A particle stops at the edge of the range and loses its speed"),
    "reflect": ("Reflect", "A particle bounces off the edge of the range"),
}
_SEEDS = {
    "random": ("Random", "The first particles stand anywhere"),
    "lambert": ("Lambert", "Some of the first particles stand around a Lambertian fit of the photographs"),
    "given": ("Given", "Some of the first particles stand around a first guess, which only scripts can give"),
}
_NORMALS = {
    "hemisphere": ("Hemisphere", "A normal is two numbers on the hemisphere"),
    "cartesian": ("Cartesian", "A normal is three numbers that are normalized, as in the paper"),
}
_LOSSES = {
    "l1": ("Absolute", "Mean absolute difference, as in the paper"),
    "l2": ("Squared", "Mean squared difference: shadows and highlights pull hard on it"),
    "robust": ("Robust", "log(1 + (e/delta)²): differences well above Delta hardly count; best on photographs"),
}


@dataclass(frozen=True)
class Swarm:
    """The update of Eq. 2–4. Positions are in [0, 1], so a speed is a fraction of the parameter's range.

    inertia: Shi & Eberhart 1998. constriction: Clerc & Kennedy 2002.
    """

    update: Update = setting("Update", "What moves in an iteration", choices=_UPDATE)
    linear: LinearKind = setting("Albedo", "How albedo and other linear weights are found", choices=_LINEAR)
    particles: int = setting("Particles", "Fewest particles of each texel's swarm", least=1, soft_max=64)
    particles_per_dimension: float = setting(
        "Per Dimension", "Particles for each number that is searched, if that makes more", soft_max=8
    )
    inertia: float = setting("Inertia", "The part of its velocity that a particle keeps; 1 as in the paper", soft_max=1)
    constriction: float = setting("Constriction", "Factor of the whole velocity; 1 as in the paper", soft_max=1)
    c1: float = setting("Own Best", "c1 of Eq. 2: pull towards the particle's own best", soft_max=3)
    c2: float = setting("Swarm's Best", "c2 of Eq. 2: pull towards the best of the swarm", soft_max=3)
    c3: float = setting(
        "Neighbors", "c3 of Eq. 2: pull towards the mean of the neighboring texels' bests", soft_max=0.5
    )
    c3_until: float = setting(
        "Fade Over", "The part of the iterations over which c3 falls to 0; 0 keeps it", most=1, subtype=_FACTOR
    )
    neighbourhood: int = setting(
        "Window", "H of Eq. 4: side of the window of neighbors, in texels; odd", least=1, odd=True, soft_max=9,
        subtype="PIXEL",
    )  # fmt: skip
    neighbour_every: int = setting(
        "Try Every", "Iterations between those in which a particle tries the best of a neighboring texel; 0 never",
        soft_max=50,
    )  # fmt: skip
    v_max: float = setting("Speed Limit", "Largest step, as a part of a parameter's range", above=True, soft_max=1)
    walls: Walls = setting("Walls", "What happens to a particle that would leave the range", choices=_WALLS)
    start_speed: float = setting("Start Speed", "Largest first step, as a part of a parameter's range", soft_max=1)
    seed: Seed = setting("Start", "Where the first particles stand", choices=_SEEDS)
    seeded: float = setting(
        "Seeded",
        "The part of the swarm that stands around the start; the rest stands anywhere",
        most=1,
        subtype=_FACTOR,
    )
    seed_spread: float = setting(
        "Spread", "How far around the start they stand, as a part of a parameter's range", soft_max=0.5
    )
    linear_reach: float = setting(
        "Albedo Reach", "How many times a texel's brightness its albedo may be; 0 for the whole range", soft_max=32,
        precision=1,
    )  # fmt: skip
    normal: NormalSearch = setting("Normals", "How a normal is searched", choices=_NORMALS)


@dataclass(frozen=True)
class Fitness:
    """The objective of every phase: the mean loss over the observations of a texel, plus the model's priors.

    A texel's scale is a percentile of its radiance per light intensity; delta and shadow are fractions of this scale.
    Clipped samples are lower bounds (capture/bounds.py).
    """

    loss: Loss = setting("Loss", "How a difference between render and photograph counts", choices=_LOSSES)
    delta: float = setting(
        "Delta", "The difference beyond which a sample counts as an outlier, as a part of the texel's scale",
        above=True, soft_max=0.5,
    )  # fmt: skip
    percentile: float = setting(
        "Scale At", "The percentile of its radiances that is a texel's scale", above=True, most=100,
        subtype="PERCENTAGE", precision=1,
    )  # fmt: skip
    shadow: float = setting(
        "Shadow", "Samples under this part of a texel's scale count as shadow (robust loss only)", soft_max=1
    )
    priors: bool = setting(
        "Model's Priors", "What the model states of its parameters counts where photographs say little"
    )
    bounds: bool = setting(
        "Clipped Samples", "Clipped samples count where the render is darker; else they count nothing"
    )
    highlight_power: float = setting(
        "Highlights", "Delta grows with this power of a sample's brightness above the texel's scale (robust loss only)",
        most=1, soft_max=1, precision=2,
    )  # fmt: skip


@dataclass(frozen=True)
class Prefit:
    """Normals before the stages, on grey samples, by a model of few assumptions (shaders/prefit/falloff_lobe.toml)."""

    iterations: int = setting(
        "Iterations", "Iterations of the swarms that find normals first; 0 for no prefit", 0, soft_max=100
    )
    refinement_iterations: int = setting(
        "Refinement", "Levenberg–Marquardt steps after these iterations", 5, soft_max=30
    )
    shadow: float = setting("Shadow", "Samples under this part of a texel's scale count as shadow", 0.3, soft_max=1)
    indirect_shadow: float = setting(
        "Shadow Where Indirect", "Shadow, for texels whose light is mostly indirect: their normals are prefit once"
        " more, to the brightest samples. 0 is off", 0.0, soft_max=1,
    )  # fmt: skip
    indirect_share: float = setting(
        "Least Indirect Share", "Light of other surfaces, told by its double colour or by a texel's own shadows, is"
        " taken off texels of whose light it is at least this part. 0 is off; needs Shadow Where Indirect", 0.0, most=1,
    )  # fmt: skip
    sheen_gain: float = setting(
        "Sheen Gain", "Where the prefit fits badly, a second prefit has sheen, bright at grazing angles like velvet."
        " Its normals are taken where it fits better by this part. 0 is off", 0.0, soft_max=0.5,
    )  # fmt: skip
    observations: int = setting("Fewest Photographs", "With fewer photographs the prefit is left out", 10, soft_max=100)
    acceptance_delta: float = setting(
        "Acceptance Delta", "Delta with which the prefit's normals and the model's are compared", 0.0125, above=True,
        soft_max=0.5, precision=4,
    )  # fmt: skip
    acceptance_ratio: float = setting(
        "Acceptance Ratio", "A texel whose misfit after a refinement or the prior exceeds this many times the prefit's,"
        " plus 0.005, returns to its estimate from before that step", 1.2, soft_max=4,
    )  # fmt: skip


@dataclass(frozen=True)
class Refinement:
    """Levenberg–Marquardt (Marquardt 1963) after the stages, on all their parameters jointly, with the same fitness.

    votes: shaders/refine/votes.glsl. widening: graduated non-convexity (Blake & Zisserman 1987, Visual Reconstruction):
    highlights must not count as outliers while the estimated lobe is still far from them.
    """

    iterations: int = setting(
        "Iterations", "Levenberg–Marquardt steps from the best that was found; 0 for no refinement", 0, soft_max=100
    )
    starts: bool = setting("Model's Starts", "Also begin from the values that the model names", True)
    start_iterations: int = setting("Start Steps", "Steps from each of the model's starts", 5, least=1, soft_max=30)
    rounds: int = setting("Rounds", "How often every texel tries what its neighbors have found", 1, soft_max=8)
    round_iterations: int = setting("Round Steps", "Steps after each round", 8, least=1, soft_max=30)
    candidate_ratio: float = setting(
        "Candidate Ratio", "A neighbor's material is refined where its fitness is below this many times its own;"
        " more tries more materials and takes longer", 1.0, soft_max=10,
    )  # fmt: skip
    votes: float = setting(
        "Votes", "Weight of agreeing neighbors against a texel's own samples; it matters where the samples are"
        " ambiguous. More leaves fewer lone texels; 0 is off", 0.0, soft_max=4,
    )  # fmt: skip
    damping: float = setting(
        "Damping",
        "The first λ of Levenberg–Marquardt, as a part of the diagonal of JᵀJ",
        0.01,
        above=True,
        soft_max=1,
        precision=4,
    )
    ftol: float = setting(
        "Function Tolerance", "A texel is done once two steps gain less than this part of its fitness", 1e-5,
        soft_max=0.01, precision=6,
    )  # fmt: skip
    xtol: float = setting(
        "Step Tolerance", "A texel is done once a step moves nothing by more than this part of its range", 1e-5,
        soft_max=0.01, precision=6,
    )  # fmt: skip
    central: bool = setting(
        "Central Differences", "Differences to both sides instead of one: slower, more exact", False
    )
    widening: float = setting(
        "Widening", "How many times as wide Delta is at first, from the model's starts; it falls to its own value", 1.0,
        least=1, soft_max=100,
    )  # fmt: skip


@dataclass(frozen=True)
class Materials:
    """Shared materials: the means of a mixture of Gaussians over a sample of all texels.

    In the first round a texel tries them with its own normal, in later rounds with the normal that mirrors its
    brightest sample. The steps of a round begin with the refinement's widening.
    """

    rounds: int = setting(
        "Rounds", "How often every texel tries the materials that the surface shares; 0 for none of this", 0, soft_max=8
    )
    iterations: int = setting("Round Steps", "Levenberg–Marquardt steps after each round", 6, least=1, soft_max=30)
    count: int = setting("Materials", "Most materials of the surface", 16, least=1, soft_max=64)
    weight: float = setting(
        "Weight", "Neighbors' votes that a material of the whole surface counts for", 1000.0,
        soft_max=10000, precision=0,
    )  # fmt: skip


@dataclass(frozen=True)
class Prior:
    """The spatial prior: similar neighbours constrain the numbers that a texel's own samples leave undetermined."""

    rounds: int = setting("Rounds", "How often similar neighbors are asked; 0 for no prior", 0, soft_max=8)
    scales: int = setting("Scales", "A round reaches 2 to the power of this, in texels", 4, least=1, most=6)
    iterations: int = setting("Iterations", "Levenberg–Marquardt steps after each round", 6, least=1, soft_max=30)
    likeness: float = setting(
        "Likeness",
        "Neighbors count as similar up to this difference, as a part of a parameter's range",
        0.1,
        above=True,
        soft_max=1,
    )
    likeness_color: float = setting(
        "Color Likeness",
        "Neighbors count as similar up to this difference of their colors",
        0.1,
        above=True,
        soft_max=1,
    )
    spread: float = setting(
        "Spread",
        "Least difference that similar texels are taken to have, as a part of the range",
        0.02,
        above=True,
        soft_max=0.5,
    )
    noise_freedom: float = setting(
        "Noise Weight", "Samples of a texel's own that the neighbors' noise counts for", 10.0, above=True,
        soft_max=100, precision=1,
    )  # fmt: skip
    share: float = setting(
        "Least Share",
        "Texels on which the prior would have less influence than this stay as they are",
        0.02,
        above=True,
        soft_max=1,
    )
    tolerance: float = setting(
        "Tolerance", "By how many standard deviations of the noise the fit may become worse", 3.0, above=True,
        soft_max=10, precision=1,
    )  # fmt: skip
    turn: bool = setting("Turn Normals", "Also move normals", True)


@dataclass(frozen=True)
class Surface:
    """Integrability: normals are bent toward one surface. shaders/surface/relax.glsl states the problem."""

    rounds: int = setting(
        "Rounds", "Rounds of seven sweeps that make the slopes of neighboring texels agree, as far as their own samples"
        " leave room; 0 for none of this", 0, soft_max=8,
    )  # fmt: skip
    weight: float = setting(
        "Weight", "What it costs, as −log of a likelihood, if the slopes around four texels fail to close by one"
        " standard deviation of their noise. More bends normals further", 1.0, above=True, soft_max=4, precision=2,
    )  # fmt: skip
    tolerance: float = setting(
        "Tolerance", "By how many standard deviations of the noise a texel's fit may become worse", 3.0, above=True,
        soft_max=10, precision=1,
    )  # fmt: skip


@dataclass(frozen=True)
class Interreflection:
    """Interreflection: estimated from the maps and subtracted from the photographs; then all phases run again.

    Nayar, Ikeuchi & Kanade 1991, Shape from Interreflections.
    """

    rounds: int = setting(
        "Rounds", "How often the light that the subject throws on itself is found, and the maps are found again without"
        " it; 0 for never", 0, soft_max=4,
    )  # fmt: skip
    resolution: int = setting(
        "Resolution", "Most elements along the longer side of the maps, which light one another", 64, least=8,
        most=1024, soft_max=256,
    )  # fmt: skip
    rays: int = setting("Rays", "Directions that an element receives light from", 256, least=8, most=1024, soft_max=512)
    bounces: int = setting(
        "Bounces", "Most bounces of the light from surface to surface", 3, least=1, most=16, soft_max=8
    )


@dataclass(frozen=True)
class Stage:
    """Parameters searched together: names of parameters, or of stages in the model's table; "all" for every one."""

    search: tuple[str, ...]
    iterations: int = setting("Iterations", "Iterations of every stage; 0 leaves them to the refinement", soft_max=5000)
