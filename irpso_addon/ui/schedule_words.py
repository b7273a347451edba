"""The words, soft limits and units with which the settings of a schedule are shown; the values are in presets/."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Words:
    """How a setting is shown: its label, its tooltip, the top of its slider, its unit, decimals and choices.

    choices: value → (label, tooltip), where it is one of several.
    """

    label: str
    tip: str
    soft_max: float | None = None
    subtype: str = "NONE"
    precision: int = 3
    choices: dict[str, tuple[str, str]] | None = None


GROUPS = {  # panel → the settings in it, in order
    "Stages": ("iterations", "cycles", "threshold", "levels", "level_iterations"),
    "Swarm": (
        "update", "linear", "particles", "particles_per_dimension", "inertia", "constriction", "c1", "c2", "c3",
        "c3_until", "neighbourhood", "neighbour_every", "v_max", "walls", "start_speed", "seed", "seeded",
        "seed_spread", "linear_reach", "normal",
    ),
    "Prefit": (
        "prefit_iterations", "prefit_refinement_iterations", "prefit_shadow", "prefit_observations", "prefit_acceptance_delta",
        "prefit_acceptance_ratio",
    ),
    "Fitness": ("loss", "delta", "percentile", "shadow", "highlight_power", "bounds", "priors"),
    "Refinement": (
        "refinement_iterations", "refinement_starts", "refinement_start_iterations", "refinement_rounds", "refinement_round_iterations",
        "refinement_accept_ratio", "refinement_votes", "refinement_damping", "refinement_ftol", "refinement_xtol", "refinement_central",
        "refinement_widening",
    ),
    "Materials": ("materials_rounds", "materials_iterations", "materials_count", "materials_weight"),
    "Prior": (
        "prior_rounds", "prior_scales", "prior_iterations", "prior_likeness", "prior_likeness_color", "prior_spread",
        "prior_noise_freedom", "prior_share", "prior_tolerance", "prior_turn",
    ),
}  # fmt: skip

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
    "robust": ("Robust", "Differences well above Delta hardly count: best on photographs"),
}

WORDS = {
    "iterations": Words("Iterations", "Iterations of every stage; 0 leaves them to the refinement", 5000),
    "cycles": Words("Cycles", "How often the stages are gone through", 10),
    "threshold": Words(
        "Stop at Error", "A swarm stops once its fitness is below this; 0 never stops early", 0.1, precision=5
    ),
    "levels": Words(
        "Levels",
        "How many sizes are solved, each half the next, the smaller ones as first guess; 1 solves the full size alone",
    ),
    "level_iterations": Words(
        "Finer Levels", "The part of the iterations that all levels but the coarsest make", subtype="FACTOR"
    ),
    "update": Words("Update", "What moves in an iteration", choices=_UPDATE),
    "linear": Words("Albedo", "How albedo and other linear weights are found", choices=_LINEAR),
    "particles": Words("Particles", "Particles of each texel's swarm, at least", 64),
    "particles_per_dimension": Words(
        "Per Dimension", "Particles for each number that is searched, where that makes more", 8
    ),
    "inertia": Words("Inertia", "The part of its velocity that a particle keeps; 1 as in the paper", 1),
    "constriction": Words(
        "Constriction", "Factor on the whole velocity (Clerc and Kennedy 2002); 1 as in the paper", 1
    ),
    "c1": Words("Own Best", "c1 of Eq. 2: pull towards the particle's own best place", 3),
    "c2": Words("Swarm's Best", "c2 of Eq. 2: pull towards the best place of the swarm", 3),
    "c3": Words("Neighbors", "c3 of Eq. 2: pull towards the mean of the neighboring texels' bests", 0.5),
    "c3_until": Words(
        "Fade Over",
        "The part of the iterations over which the pull of the neighbors falls to 0; 0 keeps it",
        subtype="FACTOR",
    ),
    "neighbourhood": Words("Window", "Side of the window of neighbors, in texels; odd", 9, "PIXEL"),
    "neighbour_every": Words(
        "Try Every",
        "Iterations between those in which a particle tries the best of a neighboring texel; 0 never",
        50,
    ),
    "v_max": Words("Speed Limit", "Largest step, as a part of a parameter's range", 1),
    "walls": Words("Walls", "What a particle does that would leave the range", choices=_WALLS),
    "start_speed": Words("Start Speed", "Largest first step, as a part of a parameter's range", 1),
    "seed": Words("Start", "Where the first particles stand", choices=_SEEDS),
    "seeded": Words(
        "Seeded", "The part of the swarm that stands around the start; the rest stands anywhere", subtype="FACTOR"
    ),
    "seed_spread": Words("Spread", "How far around the start they stand, as a part of a parameter's range", 0.5),
    "linear_reach": Words(
        "Albedo Reach", "How many times a texel's brightness its albedo may be; 0 for the whole range", 32, precision=1
    ),
    "normal": Words("Normals", "How a normal is searched", choices=_NORMALS),
    "prefit_iterations": Words("Iterations", "Iterations of the swarms that find normals first; 0 for no prefit", 100),
    "prefit_refinement_iterations": Words("Refinement", "Levenberg–Marquardt steps after them", 30),
    "prefit_shadow": Words("Shadow", "Samples under this part of a texel's scale count as shadow", 1),
    "prefit_observations": Words("Least Images", "With fewer observations the prefit is left out", 100),
    "prefit_acceptance_delta": Words(
        "Acceptance Delta", "Delta with which the prefit's normals and the model's are compared", 0.5, precision=4
    ),
    "prefit_acceptance_ratio": Words(
        "Acceptance Ratio",
        "Where the model fits worse than the prefit by more than this factor, the prefit's normal stays",
        4,
    ),
    "loss": Words("Loss", "How a difference between render and photograph counts", choices=_LOSSES),
    "delta": Words(
        "Delta", "The difference beyond which a sample counts as an outlier, as a part of the texel's scale", 0.5
    ),
    "percentile": Words(
        "Scale At", "The percentile of its radiances that is a texel's scale", subtype="PERCENTAGE", precision=1
    ),
    "shadow": Words("Shadow", "Samples under this part of a texel's scale count as shadow (robust loss only)", 1),
    "highlight_power": Words(
        "Highlights",
        "Delta grows with this power of a sample's brightness above the texel's scale (robust loss only)",
        1,
        precision=2,
    ),
    "bounds": Words("Clipped Samples", "Clipped samples count where the render is darker; else they count nothing"),
    "priors": Words("Model's Priors", "What the model believes of its parameters counts where photographs say little"),
    "refinement_iterations": Words(
        "Iterations", "Levenberg–Marquardt steps from the best that was found; 0 for no refinement", 100
    ),
    "refinement_starts": Words("Model's Starts", "Begin from the places that the model names as well"),
    "refinement_start_iterations": Words("Start Steps", "Steps from each of these places", 30),
    "refinement_rounds": Words("Rounds", "How often every texel tries what its neighbors have found", 8),
    "refinement_round_iterations": Words("Round Steps", "Steps after each round", 30),
    "refinement_accept_ratio": Words(
        "Accept Ratio", "A neighbor's material is tried where its fitness is under so many times the texel's own", 10
    ),
    "refinement_votes": Words(
        "Votes",
        "What like neighbors count against a texel's own samples where these hardly decide; more leaves fewer lone"
        " texels, 0 none of this",
        4,
    ),
    "refinement_damping": Words("Damping", "The first damping, as a part of the diagonal", 1, precision=4),
    "refinement_ftol": Words(
        "Function Tolerance",
        "A texel is done once two steps gain less than this part of its fitness",
        0.01,
        precision=6,
    ),
    "refinement_xtol": Words(
        "Step Tolerance",
        "A texel is done once a step moves nothing by more than this part of its range",
        0.01,
        precision=6,
    ),
    "refinement_central": Words("Central Differences", "Differences to both sides instead of one: slower, more exact"),
    "refinement_widening": Words(
        "Widening", "From the model's starts Delta is so many times as wide at first, and falls to its own", 100
    ),
    "materials_rounds": Words(
        "Rounds", "How often every texel tries the materials that the surface shares; 0 for none of this", 8
    ),
    "materials_iterations": Words("Round Steps", "Levenberg–Marquardt steps after each round", 30),
    "materials_count": Words("Materials", "How many materials there are, at most", 64),
    "materials_weight": Words(
        "Weight", "A material that the whole surface is of counts like so many neighbors' votes", 10000, precision=0
    ),
    "prior_rounds": Words("Rounds", "How often alike neighbors are asked; 0 for no prior", 8),
    "prior_scales": Words("Scales", "A round reaches 2 to this power texels"),
    "prior_iterations": Words("Iterations", "Levenberg–Marquardt steps after each round", 30),
    "prior_likeness": Words("Likeness", "Neighbors are alike that differ by this part of a parameter's range", 1),
    "prior_likeness_color": Words("Color Likeness", "Neighbors are alike whose colors differ by this part", 1),
    "prior_spread": Words("Spread", "Alike texels are taken to differ by this part of the range, at least", 0.5),
    "prior_noise_freedom": Words(
        "Noise Weight", "For how many samples of a texel's own the neighbors' noise counts", 100, precision=1
    ),
    "prior_share": Words("Least Share", "A texel is left alone of which the prior would have less than this", 1),
    "prior_tolerance": Words(
        "Tolerance", "By how many standard deviations of the noise the fit may become worse", 10, precision=1
    ),
    "prior_turn": Words("Turn Normals", "Whether normals are moved too"),
}
