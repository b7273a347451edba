"""Live maps as pictures on the GPU, for a window to draw, without read-back."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...core.errors import InputError
from ...core.files import defined
from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.kernel import Kernel, Output, Packed
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...reflectance.model import Parameter, ReflectanceModel
from ...results.false_color import COLORS, UNCOVERED
from ...results.maps import Cause, Maps
from ..engine.engine import RecoveryEngine
from ..engine.progress import Progress
from ..kernels import declarations
from ..kernels.single_passes import residual_pass
from ..phases.phase import BACKGROUND_BAND_SECONDS, BAND_SECONDS
from ..state.packing import Packing, level_size
from ..state.textures import kernel_defines

KEPT = 4  # pictures kept: two areas of the window, each with two side by side
_SHARE = 0.2  # part of the time for measurements while the recovery runs
_UNMEASURED = -1.0
_ENCODINGS = defined("view/show_parameter.glsl", "ENCODING_")
_PARAMETER = {"u_at": "INT", "u_components": "INT", "u_encoding": "INT", "u_low": "FLOAT", "u_width": "FLOAT",
              "u_unknown": "FLOAT"}  # fmt: skip
_OBSERVATION = {"u_observation": "INT", "u_exposure": "FLOAT"}
_MEASURE = {"u_at": "INT", "u_components": "INT", "u_limit": "FLOAT"}


@dataclass(frozen=True)
class Shown:
    """Content of a picture.

    parameter: for kinds "parameter" and "confidence". observation: for "render" and "reference". limit: the value
    shown as red: an error in radiance, a standard deviation in the parameter's unit (radians of a normal), a share of
    the light for "indirect". exposure: factor on radiance. unknown: the deviation above which a parameter of one number
    is unknown, which alpha shows; 0 for never.
    """

    kind: Literal["parameter", "error", "render", "reference", "confidence", "indirect"]
    parameter: str = ""
    observation: int = 0
    limit: float = 0.1
    exposure: float = 1.0
    unknown: float = 0.0

    @property
    def measured(self) -> str:
        """The measurement that the picture needs: "error", "confidence", or ""."""
        if self.kind in ("error", "confidence"):
            return self.kind
        return "confidence" if self.unknown else ""


class Display:
    """Pictures of a running recovery. ``close`` it before the recovery; make a new one for another recovery.

    whole: the recovery of which this one is a tile; it has the indirect light. Raises InputError for a tiled recovery.
    """

    def __init__(self, recovery: RecoveryEngine, whole: RecoveryEngine | None = None):
        if recovery.capabilities.view != "whole":
            raise InputError("the recovery runs in tiles, which cannot be shown while it runs; lower the resolution")
        self._recovery, self._whole = recovery, whole or recovery
        self._defines = kernel_defines(recovery.domain)
        self._level: tuple[tuple[int, int], frozenset[str]] | None = None
        self._begin()

    def picture(self, shown: Shown, time_budget_s: float | None = None) -> Texture:
        """Return an RGBA16F texture of the domain's size (or the coarse level's); later pictures may overwrite it.

        Display values: colours encoded as sRGB, normals as n/2 + 1/2, numbers as a fraction of their range; errors,
        deviations (the largest of a parameter's components) and indirect light in false colours. Alpha is 1 for solved
        texels, 0.5 for an unknown parameter (see ``Shown.unknown``) or a reference's sample without weight, 0 without a
        photograph or, so far, without an estimate of indirect light.

        time_budget_s: about the time for measuring errors or deviations now. Until a measurement is complete the last
        complete one is shown; the first one is shown while it runs. Without a budget the measurement is current. Raises
        InputError for a missing parameter or observation.
        """
        self._check(shown)
        with self._recovery.view() as lent:
            self._follow_level(lent)
            progress = self._recovery.progress
            measured = self._measure(shown.measured).update(lent, progress, time_budget_s) if shown.measured else 0
            picture, drawn = self._texture_of(shown, lent)
            if drawn != (progress, measured):
                self._draw(shown, picture, lent)
                self._pictures[shown] = picture, (progress, measured)
            return picture

    def pending(self, shown: Shown) -> bool:
        """Return whether the picture is older than the recovery's state and should be drawn again soon."""
        if shown.measured:
            return self._measure(shown.measured).measured != self._recovery.progress
        drawn = self._pictures.get(shown)
        return drawn is None or drawn[1] != (self._recovery.progress, 0)

    def unknown_at(self, row: int, column: int) -> dict[str, Cause] | None:
        """Return parameter → why it is unknown, of those that are unknown at a solved texel of the domain.

        None before a ``picture`` has measured the current deviations, and at a coarser level.
        """
        measure, domain, model = self._measures.get("confidence"), self._recovery.domain, self._recovery.model
        if measure is None or measure.measured != self._recovery.progress:
            return None
        if self._level is None or self._level[0][::-1] != domain.shape:
            return None
        measured = list(measure.bindings().values())
        place = Packing(domain.solvable, domain.seams).places(np.array([row]), np.array([column]))
        numbers = np.concatenate([textures.texels(texture, place)[0] for texture in measured])
        (x, y), (x0, y0) = domain.origin, self._whole.domain.origin
        at, deviations, unknown = (slice(row + y - y0, row + y - y0 + 1), column + x - x0), {}, {}
        for p in model.parameters:
            first = model.offset(p.name)
            deviations[p.name] = numbers[None, None, first : first + (1 if p.is_normal else p.components)]
            unknown[p.name] = {cause: mask[at][None] for cause, mask in self._whole.unknown_texels(p.name).items()}
        maps = Maps(model, {}, np.ones((1, 1), bool), confidence=deviations, unknown_texels=unknown)
        causes = maps.unknown_by_cause()
        return {name: cause for name, masks in causes.items() for cause, mask in masks.items() if mask.any()}

    def close(self) -> None:
        """Free shaders and textures."""
        for pass_ in self._passes.values():
            pass_.close()
        for measure in self._measures.values():
            measure.close()
        self._begin()

    def _begin(self) -> None:
        self._passes: dict[str, Pass] = {}
        self._measures: dict[str, _Measure] = {}
        # Each with the progress and the version of the measurement from which it was drawn.
        self._pictures: OrderedDict[Shown, tuple[Texture, tuple[Progress, int] | None]] = OrderedDict()
        self._ramp: Texture | None = None
        self._share: tuple[np.ndarray, Texture] | None = None  # the recovery's array, and its texture
        self._least: dict[str, tuple[list[np.ndarray], Texture]] = {}  # by parameter: the recovery's masks

    def _check(self, shown: Shown) -> None:
        if shown.kind in ("parameter", "confidence"):
            self._recovery.model.parameter(shown.parameter)
        elif not 0 <= shown.observation < self._recovery.domain.observations:
            count = self._recovery.domain.observations
            raise InputError(f"observation {shown.observation}: there are {count}, from 0; choose one of them")

    def _follow_level(self, lent: Mapping[str, Texture]) -> None:
        """Restart if the recovery has reached a level of another size, or a round that searches other parameters."""
        level = level_size(lent, self._defines), self._recovery.unsearched
        if level != self._level:
            self.close()
            self._level = level

    def _texture_of(self, shown: Shown, lent: Mapping[str, Texture]) -> tuple[Texture, tuple[Progress, int] | None]:
        """Return the picture's texture, and the state from which it was drawn, or None."""
        if shown not in self._pictures:
            if len(self._pictures) < KEPT:
                self._pictures[shown] = textures.empty(*level_size(lent, self._defines), "RGBA16F"), None
            else:  # passes keep the frame buffers of their targets, so textures are reused
                _, (oldest, _) = self._pictures.popitem(last=False)
                self._pictures[shown] = oldest, None
        self._pictures.move_to_end(shown)
        return self._pictures[shown]

    def _draw(self, shown: Shown, picture: Texture, lent: Mapping[str, Texture]) -> None:
        model, inputs = self._recovery.model, dict(lent)
        constants: dict[str, int | float]
        if shown.kind == "parameter":
            constants = _parameter_constants(model, model.parameter(shown.parameter))
            constants["u_unknown"] = shown.unknown
        elif shown.kind in ("render", "reference"):
            constants = {"u_observation": shown.observation, "u_exposure": shown.exposure}
        else:
            constants = {"u_at": 0, "u_components": 1, "u_limit": max(shown.limit, 1e-9)}  # a limit of 0: all red
            if shown.kind == "confidence":
                parameter = model.parameter(shown.parameter)
                components = 1 if parameter.is_normal else parameter.components
                constants |= {"u_at": model.offset(parameter.name), "u_components": components}
            inputs |= {"u_ramp": self._colors()}
        if shown.measured:
            inputs |= self._measured_inputs(shown)
        elif shown.kind == "indirect":
            inputs["u_measure_0"] = self._indirect(lent["u_estimate_0"])
        kind = "unknown" if shown.unknown else shown.kind
        if kind not in self._passes:
            self._passes[kind] = _picture_pass(model, kind, self._defines)
        self._passes[kind].run([picture], inputs, constants)

    def _measured_inputs(self, shown: Shown) -> dict[str, Texture]:
        """Return sampler name → measured texture; for deviations also the least ones."""
        measured = self._measure(shown.measured).bindings()
        if shown.measured == "confidence":
            return {**measured, "u_least": self._least_deviations(shown.parameter, measured["u_measure_0"])}
        return measured

    def _least_deviations(self, name: str, alike: Texture) -> Texture:
        """Return a texture like ``alike``: the range's width where a parameter is unknown whatever its estimate."""
        masks = list(self._whole.unknown_texels(name).values())
        known, texture = self._least.get(name, ([], None))
        if texture is None or len(masks) != len(known) or any(a is not b for a, b in zip(masks, known, strict=True)):
            if masks:
                unknown = self._packed(np.any(masks, axis=0))
                width = self._recovery.model.parameter(name).width
                texture = textures.upload(np.where(unknown, np.float32(width), np.float32(_UNMEASURED)))
            else:
                texture = textures.empty(alike.width, alike.height, "R32F", _UNMEASURED)
            self._least[name] = masks, texture
        return texture

    def _packed(self, values: np.ndarray) -> np.ndarray:
        """Return (H, W) values of the whole domain, packed as this recovery's textures."""
        domain = self._recovery.domain
        (x, y), (x0, y0), (height, width) = domain.origin, self._whole.domain.origin, domain.shape
        own = values[y - y0 : y - y0 + height, x - x0 : x - x0 + width]
        return Packing(domain.solvable, domain.seams).pack(own)

    def _measure(self, kind: str) -> _Measure:
        if kind not in self._measures:
            model = self._recovery.model
            if kind == "error":
                pass_ = residual_pass(model, self._defines)
                observations = {"u_observations": self._recovery.domain.observations}
                self._measures[kind] = _Measure(pass_, 1, "R32F", observations)
            else:
                pass_, constants = self._recovery.deviation_pass()
                self._measures[kind] = _Measure(pass_, declarations.packed(model).textures, "RGBA32F", constants)
        return self._measures[kind]

    def _indirect(self, alike: Texture) -> Texture:
        """Return the ``indirect_share`` of the texels, packed; below 0 without one. alike: a texture of that size."""
        share = self._whole.indirect_share
        if share is None:
            return textures.empty(alike.width, alike.height, "R32F", _UNMEASURED)
        if self._share is None or self._share[0] is not share:
            self._share = share, textures.upload(self._packed(share))
        return self._share[1]

    def _colors(self) -> Texture:
        if self._ramp is None:
            ramp = np.concatenate([COLORS, [UNCOVERED]])
            self._ramp = textures.upload(np.pad(ramp, ((0, 0), (0, 1)), constant_values=1.0)[None])
        return self._ramp


class _Measure:
    """A slow measurement of all texels, a few rows at a time; the last complete one stays available."""

    def __init__(self, pass_: Pass, count: int, texture_format: str, constants: Mapping[str, int | float]):
        self._pass, self._count, self._format = pass_, count, texture_format
        self._constants = constants
        self._bands = Bands()
        self._complete: list[Texture] = []
        self._partial: list[Texture] = []
        self._pending: Iterator[None] | None = None
        self._inputs: Mapping[str, Texture] = {}
        self._progress: Progress | None = None  # of the recovery at the start of the pending measurement
        self.measured: Progress | None = None  # and of the complete measurement
        self._version = 0
        self._seconds = self._ended = 0.0

    def update(self, lent: Mapping[str, Texture], progress: Progress, time_budget_s: float | None) -> int:
        """Continue for about ``time_budget_s``, to the end where None; return a version number of the result."""
        now = time.perf_counter()
        deadline = None if time_budget_s is None else now + time_budget_s
        if deadline is None and self._progress != progress:
            self._pending = None
        rested = now - self._ended >= self._seconds * (1 / _SHARE - 1)
        due = deadline is None or progress.done or self.measured is None or rested
        if self._pending is None and progress != self.measured and due:
            self._start(lent, progress, time_budget_s)
        if self._pending is not None:
            self._inputs = lent
            self._bands.paced = deadline is not None
        while self._pending is not None:
            if next(self._pending, self) is self:
                self._finish()
            if self.measured is None:
                self._version += 1  # shown while it runs
            if deadline is not None and time.perf_counter() >= deadline:
                break
        self._seconds += time.perf_counter() - now
        return self._version

    def bindings(self) -> dict[str, Texture]:
        """Return sampler name → measured texture."""
        return {f"u_measure_{i}": texture for i, texture in enumerate(self._complete or self._partial)}

    def close(self) -> None:
        """Free shader and textures."""
        self._pass.close()
        self._complete, self._partial, self._pending, self._inputs = [], [], None, {}

    def _start(self, lent: Mapping[str, Texture], progress: Progress, budget: float | None) -> None:
        if not self._partial:
            size = lent["u_estimate_0"].width, lent["u_estimate_0"].height
            self._partial = [textures.empty(*size, self._format, _UNMEASURED) for _ in range(self._count)]
        self._progress, self._seconds = progress, 0.0
        self._pending = self._measure_steps(self._partial, budget)

    def _measure_steps(self, targets: list[Texture], budget: float | None) -> Iterator[None]:
        """Measure into ``targets``. The recovery may run between bands: each band reads its current state."""
        self._pass.compile()
        yield  # the first band waits for the compiler
        yield from self._bands.run(
            "measure",
            targets[0].height,
            BACKGROUND_BAND_SECONDS if budget is None else min(BAND_SECONDS, 0.5 * budget),
            lambda rows: self._pass.run(targets, self._inputs, self._constants, rows),
            lambda: self._pass.fence(targets),
        )

    def _finish(self) -> None:
        self._complete, self._partial = self._partial, self._complete
        self._pending, self._inputs, self.measured = None, {}, self._progress
        self._version += 1
        self._ended = time.perf_counter()


def _parameter_constants(model: ReflectanceModel, parameter: Parameter) -> dict[str, int | float]:
    low, high = parameter.range
    encoding = "NORMAL" if parameter.is_normal else "COLOR" if parameter.color_space == "sRGB" else "FRACTION"
    return {
        "u_at": model.offset(parameter.name),
        "u_components": parameter.components,
        "u_encoding": _ENCODINGS[encoding],
        "u_low": low,
        "u_width": high - low,
    }


def _picture_pass(model: ReflectanceModel, kind: str, domain_defines: Mapping[str, str | int]) -> Pass:
    """Return the pass that draws a kind of picture."""
    packed = declarations.packed(model)
    numbers = {"error": 1, "indirect": 1, "confidence": packed.textures, "unknown": packed.textures}
    measured = Packed(numbers.get(kind, 0))
    own = {"u_estimate": packed, "u_measure": measured}
    samplers = {**own, "u_ramp": declarations.FLOAT_2D, **declarations.OBSERVATIONS, **declarations.PACKING}
    name, constants = f"show_{kind}", _OBSERVATION
    if kind in ("parameter", "unknown"):
        name, constants = "show_parameter", _PARAMETER
    elif measured.textures:
        name, constants = "show_measure", _MEASURE
    defines = dict(domain_defines)
    if kind in ("confidence", "unknown"):
        defines, samplers = defines | {"DEVIATIONS": 1}, samplers | {"u_least": declarations.FLOAT_2D}
    output, includes = Output("o_picture", "RGBA16F"), declarations.model_includes(model)
    return Pass(Kernel(f"view/{name}.glsl", (output,), samplers, constants, defines, includes))
