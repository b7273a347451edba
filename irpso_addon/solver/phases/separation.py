"""Separation of direct from indirect light: by colour on a subject of one colour, else by shadows."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np

from ...core.optional import present
from ...core.steps import map_steps
from ...gpu.bands import Bands
from ...gpu.kernel import Defines, Entry, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..kernels.declarations import FLOAT_2D, OBSERVATIONS, model_includes, packed
from ..settings.resolve import ResolvedSeparation
from ..state.phase_textures import PhaseTextures, shadow_light_table
from ..state.prefit_measurements import PrefitMeasurements
from ..state.prepare import lambert_steps
from ..state.reader import Reader
from ..state.separation import SeparatedStack, direct_chroma, median_chromas, separation_steps
from ..state.separation_record import SHADOW_LIGHT, Separation
from ..state.texel_subset import TexelSubset, chosen_texels
from ..state.textures import SOLVED, DomainTextures, Estimates, texel_states
from .phase import Phase, PhaseContext
from .prefit import adopt_pass, adopt_where

# Degrees: indirect light that turns a normal by less is not subtracted; the harmonics' errors turn it by about 1°. With
# 0 the normal error of a dirty card is 0.54 in place of 0.16°; in hollows it is 0.1° less.
MIN_TURN = 3.0


class SeparationPhase(Phase):
    """A Phase of one iteration: the chroma of direct light from a subset of the texels, then two chromas per texel.

    On a card, shadows separate the light of texels where colour does not. Where colour does, the result has the normals
    of a Lambertian fit to the direct light: normals with the bias of indirect light are a bad start for the next
    prefit. measurements: of the phases before.
    """

    has_result = False  # nothing to show before the end
    iteration = 0

    def __init__(self, resolved: ResolvedSeparation, context: PhaseContext, measurements: PrefitMeasurements):
        self.title, self.iterations = resolved.title, resolved.iterations
        self._context, self._measurements = context, measurements
        self._domain, self._least_share = context.domain, context.schedule.prefit.indirect_share
        domain = self._domain
        self._indirect = domain.packing.unpack(present(measurements.shadow)) > 0
        self._misfit = np.minimum(domain.packing.unpack(present(measurements.fitness)), 1.0)
        # On velvet lit from the side, a badly fitted normal would make the lit half count as shadow.
        sheen = measurements.sheen_chosen
        self._sheen = domain.packing.unpack(np.zeros_like(domain.scale) if sheen is None else sheen) > 0
        self._subset: TexelSubset | None = None
        self._separation = Separation.none(domain.domain.shape)
        self._adopt = adopt_pass(context.model, domain.defines)

    @property
    def evaluations(self) -> int:
        """0: this phase renders nothing."""
        return 0

    @property
    def stencil_radius(self) -> int:
        """0: neighbours are not read."""
        return 0

    @property
    def needs_texel_subset(self) -> bool:
        """Whether the subset of the whole domain is missing."""
        return not self.done and self._subset is None

    def texel_subset(self) -> TexelSubset:
        """Return this tile's part of the subset; values: chroma, and 1 for indirect light."""
        domain = self._domain.domain
        rows, columns = np.nonzero(texel_states(domain) == SOLVED)
        subset = chosen_texels(rows + domain.origin[1], columns + domain.origin[0], np.zeros((len(rows), 0)))
        rows, columns = subset.rows - domain.origin[1], subset.columns - domain.origin[0]
        chromas = median_chromas(domain, rows, columns).astype(np.float64)
        return replace(subset, values=np.column_stack([chromas, self._indirect[rows, columns]]))

    def take_texel_subset(self, subset: TexelSubset) -> None:
        """Set the subset of the whole domain."""
        self._subset = subset

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Separate the light of all texels of the tile."""
        if self._subset is None:
            self._subset = self.texel_subset()
            yield
        direct = direct_chroma(self._subset.values[:, :3], self._subset.values[:, 3] > 0)
        if direct is not None:
            steps = separation_steps(self._domain.domain, self._indirect, direct, self._least_share)
            self._separation = yield from map_steps(steps, lambda part: None)
        # Not on a mesh: samples in its cast shadows have weight 0, so that they give no evidence.
        if self._domain.domain.card:
            separated = self._separation.separated
            model, entry = self._context.model, self._context.entry
            pass_ = shadow_light_pass(model, self._least_share, MIN_TURN, self._domain.defines, entry)
            misfit = np.where(separated | self._sheen, 0, self._misfit)
            asked = shadow_light_steps(pass_, self._domain, self._context.estimates, misfit, bands, seconds)
            by_shadows = Separation.of_shadows((yield from asked))
            self._separation = self._separation.where(separated, by_shadows)
        self.iteration += 1

    @property
    def keeps_estimates(self) -> bool:
        """Whether no light was separated."""
        return not self._separation.any()

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the normals of the fit to direct light into the next estimates, if light was separated."""
        if self.keeps_estimates:
            return
        domain, packing = self._domain.domain, self._domain.packing
        chosen = domain.solvable & self._separation.by_colour
        direct = SeparatedStack(domain, self._separation)
        steps = lambert_steps(replace(domain, stack=direct, solvable=chosen))
        normal, _ = yield from map_steps(steps, lambda part: None)
        yield from adopt_where(self._adopt, bands, self._context, packing.pack(chosen), packing.pack(normal))

    def measure_steps(self, bands: Bands, seconds: float) -> Generator[None, None, PrefitMeasurements]:
        """Yields once; returns the measurements, with the separation if any light was separated."""
        yield
        if not self._separation.any():
            return self._measurements
        return replace(self._measurements, separation=self._separation.packed(self._domain.packing))

    def halo(self) -> np.ndarray:
        """Return (H, W, 1) zeros: neighbours read nothing."""
        return np.zeros((*self._domain.domain.shape, 1), np.float32)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Do nothing: neighbours read nothing."""

    def state(self) -> dict[str, np.ndarray]:
        """Return {}: the phase restarts."""
        return {}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Do nothing: the phase restarts."""

    def close(self) -> None:
        """Free the shader."""
        self._adopt.close()


def shadow_light_pass(model: ReflectanceModel, least: float, turn: float, defines: Defines, entry: Entry) -> Pass:
    """Compile the pass that estimates indirect light from shadows.

    It reports light that is at least the part ``least`` of a texel's and turns the normal by ``turn`` degrees or more.
    """
    samplers: Samplers = {"u_estimate": packed(model), **OBSERVATIONS, "u_misfit": FLOAT_2D}
    normal = model.normal
    defines = {
        **defines, "WITH_SHADOW": 1, "NORMAL_COMPONENT": model.offset(normal), "MIN_SHARE": f"{least:.9f}",
        "MIN_TURN": f"{2 * math.sin(math.radians(turn) / 2):.9f}",
    }  # fmt: skip
    outputs = tuple(Output(name) for name in ("o_low", "o_middle", "o_high"))
    constants, includes = {"u_observations": "INT"}, model_includes(model)
    return Pass(Kernel("prefit/shadow_light.glsl", outputs, samplers, constants, defines, includes), entry)


def shadow_light_steps(
    pass_: Pass, domain: DomainTextures, estimates: Estimates, misfit: np.ndarray, bands: Bands, seconds: float
) -> Generator[None, None, np.ndarray]:
    """Return (H, W, SHADOW_LIGHT) float32: the output of shadow_light.glsl.

    0 everywhere if a light lacks a channel. misfit: (H, W), the prefit's loss, at most 1; texels of 0 are skipped.
    pass_: from ``shadow_light_pass``; closed at the end. In bands of rows of about ``seconds``; yields after each.
    """
    phase_textures = PhaseTextures(shadow_light_table(), *estimates.size)
    with closing(pass_), closing(phase_textures), closing(Reader(pass_.entry)) as reader:
        if not (domain.domain.intensities > 0).all():
            return np.zeros((*domain.domain.shape, SHADOW_LIGHT), np.float32)
        phase_textures.upload("misfit", [domain.packing.pack(misfit[..., None].astype(np.float32))])
        yield from phase_textures.make()
        inputs = {**estimates.bindings(), **domain.textures, **phase_textures.bindings()}
        constants = {"u_observations": domain.domain.observations}
        yield from pass_.in_bands("shadow light", bands, seconds, phase_textures.of("light"), inputs, constants)
        packed = np.concatenate([reader.read(texture) for texture in phase_textures.of("light")], axis=-1)
    return domain.packing.unpack(packed)
