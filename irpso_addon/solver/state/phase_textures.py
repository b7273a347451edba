"""Textures of a phase, declared once: its table gives allocation, bindings, checkpoint arrays and bytes."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...gpu import context, textures
from ...gpu.textures import CHANNELS, Texture
from .textures import UNFIT

PARTICLES = ("position", "velocity", "best", "fitness")  # groups in the atlas
GLOBAL_BESTS = ("global_best", "global_linear", "global_fitness")
_SIDE = 16384  # of a texture, assumed for byte counts: it rarely changes the layout of an atlas


@dataclass(frozen=True)
class TextureGroup:
    """Textures that are allocated, written and swapped together.

    samplers: names in shaders, one per texture. arrays: names in checkpoints; empty if no later iteration reads the
    textures. value: initial content. in_atlas: one W×H tile per particle and block, otherwise W×H. double: a second
    set, which a pass writes while it reads the first.
    """

    samplers: tuple[str, ...]
    arrays: tuple[str, ...] = ()
    format: str = "RGBA32F"
    value: float = 0.0
    in_atlas: bool = False
    double: bool = False


@dataclass(frozen=True)
class TextureTable:
    """The texture groups of a phase. tiles: number of W×H tiles that hold all particles; 1 without particles."""

    groups: Mapping[str, TextureGroup]
    tiles: int = 1

    @property
    def atlas_tiles(self) -> int:
        """Number of tiles of the atlas, including empty ones."""
        atlas = plan_atlas(1, 1, self.tiles, _SIDE)
        return atlas.across * atlas.down

    def bytes_per_texel(self, kept: bool = False) -> int:
        """Return the bytes of all textures, or only of those that a checkpoint holds."""
        return sum(
            4 * CHANNELS[group.format] * len(group.samplers) * (1 if kept else 1 + group.double)
            * (self.atlas_tiles if group.in_atlas else 1)
            for group in self.groups.values() if group.arrays or not kept
        )  # fmt: skip


def numbered(name: str, count: int, first: int = 0) -> tuple[str, ...]:
    """Return NAME_0, NAME_1, … from ``first`` on."""
    return tuple(f"{name}_{i}" for i in range(first, first + count))


def sequential_swarm_table(particles: int, blocks: int) -> TextureTable:
    """Return the table of a sequential swarm. blocks: RGBA texels per particle."""
    candidates = (*numbered("u_candidate_position", blocks), *numbered("u_candidate_velocity", blocks))
    groups = {
        **_particle_groups((0.5, 0.0, 0.5, UNFIT), double=False),
        "candidates": TextureGroup(candidates),
        "verdict": TextureGroup(("u_verdict",), value=-1.0),
        "global_best": TextureGroup(numbered("u_best", blocks), numbered("global_best", blocks), value=0.5),
        "global_fitness": TextureGroup(("u_best_fitness",), ("global_fitness",), "R32F", UNFIT),
    }
    return TextureTable(groups, particles * blocks)


def synchronous_swarm_table(particles: int, blocks: int, linear: int) -> TextureTable:
    """Return the table of a synchronous swarm. blocks, linear: RGBA texels of a particle and of its linear weights."""
    best, last = numbered("global_best", blocks + linear + 1), blocks + linear
    groups = {
        **_particle_groups((0.0, 0.0, 0.0, 0.0), double=True),
        "global_best": TextureGroup(numbered("u_best", blocks), best[:blocks], value=0.5, double=True),
        "global_linear": TextureGroup(numbered("u_best_linear", linear), best[blocks:last], value=0.5, double=True),
        "global_fitness": TextureGroup(("u_best_fitness",), best[last:], "R32F", UNFIT, double=True),
        "found_fitness": TextureGroup(numbered("u_fitness", -(-particles // 4))),  # of four particles each
        "found_linear": TextureGroup(numbered("u_linear", linear)),
        "mean": TextureGroup(numbered("u_mean", blocks)),
    }
    return TextureTable(groups, particles * blocks)


def _particle_groups(values: Sequence[float], double: bool) -> dict[str, TextureGroup]:
    formats = ("RGBA32F", "RGBA32F", "RGBA32F", "R32F")
    return {
        name: TextureGroup((f"u_particle_{name}",), (name,), texture_format, value, in_atlas=True, double=double)
        for name, texture_format, value in zip(PARTICLES, formats, values, strict=True)
    }


def refinement_table(estimates: int) -> TextureTable:
    """Return the table of a refinement: the best material, the one in work, and a spare one, each with a status.

    estimates: RGBA textures of a material. result: status of the best so far.
    """
    return TextureTable({
        "best": TextureGroup((*numbered("u_estimate", estimates), "u_status"), numbered("best", estimates + 1)),
        "work": TextureGroup((*numbered("u_work", estimates), "u_work_status"), numbered("work", estimates + 1),
                             double=True),
        "result": TextureGroup(("u_result",)),
    })  # fmt: skip


def sheen_table() -> TextureTable:
    """Return the table of the selection between two prefits: shaders/prefit/sheen.glsl."""
    return TextureTable({
        "fits": TextureGroup(("u_measured",), ("fits",)),
        "chosen": TextureGroup(("u_chosen",), ("chosen",), "R32F"),
    })  # fmt: skip


def indirect_table() -> TextureTable:
    """Return the table of the detection of indirect light: shaders/prefit/indirect_misfit.glsl, its result."""
    return TextureTable({
        "misfit": TextureGroup(("u_measured",), ("misfit",)),
        "shadow": TextureGroup(("u_shadow",), ("shadow",), "R32F"),
    })  # fmt: skip


def shadow_light_table() -> TextureTable:
    """Return the table of the indirect light estimated from shadows: shaders/prefit/shadow_light.glsl."""
    return TextureTable({
        "misfit": TextureGroup(("u_misfit",), (), "R32F"),
        "light": TextureGroup(("u_low", "u_middle", "u_high")),
    })  # fmt: skip


def spatial_prior_table(estimates: int) -> TextureTable:
    """Return the table of a spatial prior. estimates: RGBA textures of a material.

    noise: of the samples (shaders/spatial_prior/variance.glsl). mean, deviation: read by neighbours; after the last
    round, the prior. own: deviations from the texel's own samples alone. work, status: the estimates that are fitted to
    samples and prior. penalty: of the estimates at the start.
    """
    return TextureTable({
        "noise": TextureGroup(("u_noise",), ("noise",), double=True),
        "mean": TextureGroup(numbered("u_mean", estimates), numbered("mean", estimates), double=True),
        "deviation": TextureGroup(numbered("u_deviation", estimates), numbered("deviation", estimates), double=True),
        "own": TextureGroup(numbered("u_own", estimates), numbered("own", estimates)),
        "work": TextureGroup(numbered("u_work", estimates), numbered("work", estimates), double=True),
        "status": TextureGroup(("u_work_status",), numbered("work", 1, estimates), double=True),
        "penalty": TextureGroup(("u_penalty",), ("penalty",), "R32F"),
    })  # fmt: skip


def surface_table() -> TextureTable:
    """Return the table of the surface phase, which makes normals integrable and smooth.

    noise: of the samples (shaders/spatial_prior/variance.glsl). field, covariance: shaders/surface/relax.glsl.
    """
    return TextureTable({
        "noise": TextureGroup(("u_noise",), ("noise",), double=True),
        "field": TextureGroup(("u_field",), ("field",), double=True),
        "covariance": TextureGroup(("u_covariance",), ("covariance",)),
    })  # fmt: skip


@dataclass(frozen=True)
class Atlas:
    """Number of W×H tiles side by side, across and down."""

    across: int
    down: int


def plan_atlas(width: int, height: int, tiles: int, limit: int) -> Atlas:
    """Return the squarest atlas of ``tiles`` tiles with sides of at most ``limit`` texels. Raises InputError."""
    most = limit // max(width, 1)
    fitting = [Atlas(a, -(-tiles // a)) for a in range(1, min(most, tiles) + 1) if -(-tiles // a) * height <= limit]
    if not fitting:
        raise InputError(
            f"resolution: {tiles} tiles of {width}×{height} texels exceed this GPU's textures of {limit}×{limit};"
            " lower the resolution or the number of particles"
        )
    return min(fitting, key=lambda a: max(a.across * width, a.down * height))


class PhaseTextures:
    """The textures of a table, by group: ``current``, and ``spare`` of the doubled ones. Empty until allocated."""

    def __init__(self, table: TextureTable, width: int, height: int):
        self.table = table
        self.atlas = plan_atlas(width, height, table.tiles, context.max_texture_size())
        self.current: dict[str, list[Texture]] = {}
        self.spare: dict[str, list[Texture]] = {}
        self._size = width, height
        self._steps = self._allocate()

    def make(self) -> Iterator[None]:
        """Allocate the missing textures; yield often: a software renderer can take 0.1 s for a large one."""
        for _ in self._steps:  # yield from would close the generator of a caller that stops early
            yield

    def ensure(self) -> None:
        """Allocate the missing textures at once."""
        for _ in self._steps:
            pass

    def close(self) -> None:
        """Free the textures; allocate no more."""
        self._steps.close()  # a suspended generator would keep them alive
        self.current.clear()
        self.spare.clear()

    def of(self, *names: str) -> list[Texture]:
        """Return the current textures of some groups."""
        return [texture for name in names for texture in self.current[name]]

    def spares(self, *names: str) -> list[Texture]:
        """Return the second sets of some groups."""
        return [texture for name in names for texture in self.spare[name]]

    def swap(self, *names: str) -> None:
        """Make the second sets the current ones."""
        for name in names:
            self.current[name], self.spare[name] = self.spare[name], self.current[name]

    def bindings(self) -> dict[str, Texture]:
        """Return all current textures by sampler name."""
        return {k: v for name, group in self.current.items() for k, v in self.bound(name, group).items()}

    def bound(self, name: str, group: Sequence[Texture]) -> dict[str, Texture]:
        """Return textures by the sampler names of a group."""
        return dict(zip(self.table.groups[name].samplers, group, strict=True))

    @property
    def persistent(self) -> dict[str, Texture]:
        """The textures that persist between iterations, by the names of their checkpoint arrays."""
        groups = self.table.groups.items()
        return {k: v for name, group in groups for k, v in zip(group.arrays, self.current[name], strict=False)}

    def restore(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Upload the arrays of ``persistent``, and allocate the other textures."""
        for name, group in self.table.groups.items():
            if group.arrays:
                self.upload(name, (arrays[array] for array in group.arrays))
        self.ensure()

    def upload(self, name: str, arrays: Iterable[np.ndarray]) -> None:
        """Replace the current textures of a group."""
        self.current[name] = [textures.upload(array) for array in arrays]

    def _allocate(self) -> Generator[None, None, None]:
        width, height = self._size
        for name, group in self.table.groups.items():
            across, down = (self.atlas.across, self.atlas.down) if group.in_atlas else (1, 1)
            for chosen in (self.current, self.spare)[: 1 + group.double]:
                if name in chosen:  # restored before
                    continue
                chosen[name] = [
                    textures.empty(across * width, down * height, group.format, group.value) for _ in group.samplers
                ]
                yield
