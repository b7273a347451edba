"""The settings of the phases after the swarms, and of interreflection, in the form of groups.py."""

from __future__ import annotations

from dataclasses import dataclass

from .setting import MAX_ROUNDS, MAX_STEPS, setting


@dataclass(frozen=True)
class Refinement:
    """Levenberg–Marquardt (Marquardt 1963) after the stages, on all their parameters jointly, with the same fitness.

    neighbour_weight: shaders/refine/neighbour_support.glsl. delta_factor: graduated non-convexity (Blake & Zisserman
    1987, Visual Reconstruction): highlights must not count as outliers while the estimated lobe is still far from them.
    race_iterations: after the idea of Maron & Moore 1994, Hoeffding Races: a start that is far behind is given up.
    """

    iterations: int = setting(
        "Iterations",
        "Levenberg–Marquardt steps from the best result of the search; 0 for no refinement",
        0,
        maximum=MAX_STEPS,
        soft_max=100,
    )
    starts: bool = setting(
        "Model's Starts", "Also refine from the starts in the model's file, and keep the best result", True
    )
    start_iterations: int = setting(
        "Start Steps", "Steps from each of the model's starts", 5, minimum=1, maximum=MAX_STEPS, soft_max=30
    )
    race_iterations: int = setting(
        "Race Steps", "Further steps from a start that is then close behind the best result so far; 0 is off", 0,
        maximum=MAX_STEPS, soft_max=30,
    )  # fmt: skip
    race_ratio: float = setting(
        "Race Ratio", "A start is close behind if its fitness is below this many times the best one. More finds more"
        " metals and takes longer", 4.0, minimum=1, soft_max=10,
    )  # fmt: skip
    race_max_observations: int = setting(
        "Race Limit", "Most photographs of a capture with which starts race; with more of them Start Steps suffice",
        32, minimum=1, soft_max=200,
    )  # fmt: skip
    rounds: int = setting(
        "Rounds", "How many times every texel tries the materials of its neighbors", 1, maximum=MAX_ROUNDS, soft_max=8
    )
    round_iterations: int = setting(
        "Round Steps", "Steps after each round", 8, minimum=1, maximum=MAX_STEPS, soft_max=30
    )
    candidate_ratio: float = setting(
        "Candidate Ratio", "A texel refines a neighbor's material if the fitness is below this many times that of"
        " its own material. More tries more materials and takes longer", 1.0, soft_max=10,
    )  # fmt: skip
    neighbour_weight: float = setting(
        "Neighbor Weight", "Weight of agreeing neighbors against a texel's own samples, where these are ambiguous."
        " More leaves fewer texels that differ from their neighbors; 0 is off", 0.0, soft_max=10,
    )  # fmt: skip
    damping: float = setting(
        "Damping",
        "The first λ of Levenberg–Marquardt, as a part of the diagonal of JᵀJ",
        0.01,
        exclusive_minimum=True,
        soft_max=1,
        precision=4,
    )
    ftol: float = setting(
        "Function Tolerance", "A texel is done once two steps gain less than this part of its fitness", 1e-5,
        soft_max=0.01, precision=6,
    )  # fmt: skip
    xtol: float = setting(
        "Step Tolerance", "A texel is done once a step changes no parameter by more than this part of its range", 1e-5,
        soft_max=0.01, precision=6,
    )  # fmt: skip
    central_differences: bool = setting(
        "Central Differences",
        "Compute derivatives from differences to both sides instead of one: slower, more exact",
        False,
    )
    delta_factor: float = setting(
        "Delta Factor", "Factor on Delta at the first step from the model's starts; it falls to 1 at the last Start"
        " Step. More finds highlights that are farther away", 1.0,
        minimum=1, soft_max=100,
    )  # fmt: skip


@dataclass(frozen=True)
class Materials:
    """Shared materials: the means of a mixture of Gaussians over a sample of all texels.

    In the first round a texel tries them with its own normal, in later rounds with the normal that mirrors its
    brightest sample. The steps of a round begin with the refinement's delta_factor.
    """

    rounds: int = setting(
        "Rounds", "How many times every texel tries the shared materials: those that many texels of the surface have;"
        " 0 is off", 0, maximum=MAX_ROUNDS, soft_max=8,
    )  # fmt: skip
    iterations: int = setting(
        "Round Steps", "Levenberg–Marquardt steps after each round", 6, minimum=1, maximum=MAX_STEPS, soft_max=30
    )
    count: int = setting("Materials", "Largest number of shared materials", 16, minimum=1, maximum=1024, soft_max=64)
    weight: float = setting(
        "Weight", "How many agreeing neighbors a shared material counts for, if the whole surface has it. More gives it"
        " to more texels", 1000.0,
        soft_max=10000, precision=0,
    )  # fmt: skip


@dataclass(frozen=True)
class SpatialPrior:
    """The spatial prior: similar neighbours constrain the numbers that a texel's own samples leave undetermined.

    bandwidth, color_bandwidth: of the kernel that weights neighbours (shaders/spatial_prior/pool.glsl).
    """

    rounds: int = setting(
        "Rounds",
        "How many times similar neighbors are averaged and texels are fitted again; 0 for no prior",
        0,
        maximum=MAX_ROUNDS,
        soft_max=8,
    )
    scales: int = setting(
        "Scales", "Distance of the farthest neighbors in a round: 2 to the power of this, in texels", 4, minimum=1,
        maximum=6,
    )  # fmt: skip
    iterations: int = setting(
        "Iterations", "Levenberg–Marquardt steps after each round", 6, minimum=1, maximum=MAX_STEPS, soft_max=30
    )
    bandwidth: float = setting(
        "Bandwidth",
        "Neighbors count as similar up to this difference, as a part of a parameter's range. More averages over"
        " more of them",
        0.1,
        exclusive_minimum=True,
        soft_max=1,
    )
    color_bandwidth: float = setting(
        "Color Bandwidth",
        "Neighbors count as similar up to this difference of their colors, as a part of the brighter one. More"
        " averages over more of them",
        0.1,
        exclusive_minimum=True,
        soft_max=1,
    )
    min_deviation: float = setting(
        "Minimum Deviation",
        "Least standard deviation that similar texels are assumed to have, as a part of a parameter's range. More"
        " leaves them more different",
        0.02,
        exclusive_minimum=True,
        soft_max=0.5,
    )
    noise_samples: float = setting(
        "Noise Samples", "Weight of the neighbors' mean noise in a texel's own noise, as a number of samples",
        10.0, exclusive_minimum=True, soft_max=100, precision=1,
    )  # fmt: skip
    min_influence: float = setting(
        "Minimum Influence",
        "A texel stays as it is if the prior would have less influence on it than this part",
        0.02,
        exclusive_minimum=True,
        soft_max=1,
    )
    tolerance: float = setting(
        "Tolerance", "How much worse a texel's fit may become, in standard deviations of the noise", 3.0,
        exclusive_minimum=True, soft_max=10, precision=1,
    )  # fmt: skip
    normals: bool = setting("Normals", "Also apply the prior to normals", True)


@dataclass(frozen=True)
class Surface:
    """Normals of one surface: integrable (shaders/surface/relax.glsl), and as smooth as their noise allows
    (smooth.glsl).
    """

    rounds: int = setting(
        "Rounds", "Number of rounds, of seven sweeps each. A sweep turns normals so that the slopes of neighboring"
        " texels agree better, within what each texel's own samples allow; 0 is off", 0, maximum=MAX_ROUNDS, soft_max=8,
    )  # fmt: skip
    weight: float = setting(
        "Weight", "Cost, as −log of a likelihood, if the slopes around four texels sum to one standard deviation"
        " of their noise instead of 0. More turns normals further", 1.0, exclusive_minimum=True, soft_max=4,
        precision=2,
    )  # fmt: skip
    tolerance: float = setting(
        "Tolerance", "How much worse a texel's fit may become, in standard deviations of the noise", 3.0,
        exclusive_minimum=True, soft_max=10, precision=1,
    )  # fmt: skip
    smoothness: float = setting(
        "Smoothness", "Afterward, slopes move toward the plane of their neighbors' slopes as far as noise explains the"
        " difference. This multiplies the variance of the noise: 1 is as measured, 0 is off", 0.0, soft_max=2,
        precision=2,
    )  # fmt: skip


@dataclass(frozen=True)
class Interreflection:
    """Interreflection: estimated from the maps and subtracted from the photographs; then all phases run again.

    Nayar, Ikeuchi & Kanade 1991, Shape from Interreflections.
    """

    rounds: int = setting(
        "Rounds", "How many times the light that the subject throws on itself is computed and subtracted, and the"
        " maps are recovered again. More takes longer; 0 is off", 0, maximum=MAX_ROUNDS, soft_max=4,
    )  # fmt: skip
    matte_rounds: int = setting(
        "Matte Rounds", "On a mesh with predicted shadows: rounds before the first recovery that take the surfaces for"
        " matte and find their base colors alone. They are short. Where surfaces are not matte, a full round follows."
        " 0 is off", 0, maximum=MAX_ROUNDS, soft_max=4,
    )  # fmt: skip
    resolution: int = setting(
        "Resolution", "Largest number of surface elements along the longer side of a UDIM tile; light is exchanged"
        " between them. More shows smaller hollows and takes longer", 64, minimum=8,
        maximum=1024, soft_max=256,
    )  # fmt: skip
    rays: int = setting(
        "Rays",
        "Number of directions from which an element receives light. More has less noise and takes longer",
        256,
        minimum=8,
        maximum=1024,
        soft_max=512,
    )
    bounces: int = setting(
        "Bounces", "Largest number of bounces of the light between surfaces", 3, minimum=1, maximum=16, soft_max=8
    )

    @property
    def estimates(self) -> int:
        """How many times the light is estimated."""
        return self.rounds + self.matte_rounds
