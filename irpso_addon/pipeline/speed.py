"""Measures the speed of recoveries on this machine, phase by phase: the default preset on a rendered card."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.paths import DEFAULT_MODEL
from ..core.waves import wave_field, wave_values
from ..geometry.domain import Domain, domain_of, flat_bake, tile
from ..gpu import context, textures
from ..gpu.program import ProgramCache
from ..reflectance.model import ReflectanceModel, load_model
from ..solver.engine.recovery import Recovery
from ..solver.planning.cost import recovery_cost
from ..solver.planning.forecast import forecast_text
from ..solver.planning.memory import amount
from ..solver.settings.schedule import Schedule, load_schedule
from ..solver.views.forward import Renderer, dome

_PRESET = "standard"
_SIDE = {True: 192, False: 1024}  # texels of the card, by whether the renderer is software: some seconds
_WARM = 16  # texels of a side, in the recovery that compiles the shaders
_LIGHTS = (6, 8)  # latitudes and longitudes of a sphere of lights, whose upper half lights the card
_TRANSFER, _REPEATS = 64 << 20, 5  # bytes of the texture that is uploaded and read back
_SPREAD = 1.5  # factor by which a forecast may be off: other subjects, other load of the machine
_CAPTURES = {
    "the sample's tile": (378**2, 14),
    "a card of one megapixel": (10**6, 24),
    "twelve megapixels": (12 * 10**6, 24),
    "the same under 96 lights": (12 * 10**6, 96),
}  # texels, photographs


@dataclass(frozen=True)
class PhaseSpeed:
    """A phase of the search. renders: of one texel in one photograph, summed over all evaluations."""

    title: str
    seconds: float
    renders: int

    @property
    def rate(self) -> float:
        """Renders per second."""
        return self.renders / self.seconds


@dataclass(frozen=True)
class Speed:
    """The measured speed of a recovery of ``texels``. compiling: seconds of all shaders, if the driver caches none.

    upload, download: bytes per second of a texture. captures: name → ((least, most seconds), device bytes) of other
    recoveries, forecast from this one.
    """

    texels: int
    observations: int
    compiling: float
    phases: tuple[PhaseSpeed, ...]
    upload: float
    download: float
    captures: Mapping[str, tuple[tuple[float, float], int]]

    @property
    def seconds(self) -> float:
        """The seconds of the whole search."""
        return sum(phase.seconds for phase in self.phases)

    def lines(self) -> Iterator[str]:
        """Yield the report, for people."""
        yield f"measured      {self.texels} texels, {self.observations} photographs, {DEFAULT_MODEL}, {_PRESET}"
        yield f"shaders       {self.compiling:.1f} s to compile, less where the driver knows them"
        yield f"transfers     {amount(int(self.upload))}/s to the device, {amount(int(self.download))}/s back"
        yield "phase                                     seconds   share   million renders/s"
        for phase in self.phases:
            share = phase.seconds / self.seconds
            yield f"  {phase.title:38} {phase.seconds:8.2f}  {share:6.1%}  {phase.rate / 1e6:18.1f}"
        yield "a render is one texel in one photograph; of a search, where all of it fits the device:"
        for name, (seconds, device) in self.captures.items():
            texels, photographs = _CAPTURES[name]
            size = f"{texels / 1e6:5.2f} M texels × {photographs:2}"
            yield f"  {name:26} {size}   {forecast_text(seconds):18} {amount(device)}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON."""
        return {
            "texels": self.texels, "photographs": self.observations, "model": DEFAULT_MODEL, "preset": _PRESET,
            "compiling_seconds": self.compiling, "upload_bytes_per_second": self.upload,
            "download_bytes_per_second": self.download,
            "phases": {p.title: {"seconds": p.seconds, "renders_per_second": p.rate} for p in self.phases},
            "captures": {
                name: {"seconds": list(seconds), "device_bytes": device}
                for name, (seconds, device) in self.captures.items()
            },
        }  # fmt: skip


def measure_speed(side: int | None = None) -> Speed:
    """Measure the speed of this device on a card of ``side`` × ``side`` texels, in some 20 s.

    side: None for 1024, on a software renderer 192. Raises GpuUnavailableError.
    """
    context.ensure()
    side = side or _SIDE[context.is_software(str(context.describe()["renderer"]))]
    model, schedule = load_model(DEFAULT_MODEL), load_schedule(_PRESET).without_rounds()  # a card has none
    domain = make_card(model, side)
    with closing(ProgramCache()):
        middle = (side - min(side, _WARM)) // 2
        small = tile(domain, middle, middle, min(side, _WARM), min(side, _WARM))
        started = time.perf_counter()
        list(_timed(small, model, schedule))
        compiling = time.perf_counter() - started
        phases = tuple(_timed(domain, model, schedule))
    texels = int(domain.solvable.sum())
    cost = recovery_cost(model, schedule, (), domain.observations)
    rate = sum(phase.seconds for phase in phases) / (cost.work * texels)
    captures = {}
    for name, (count, observations) in _CAPTURES.items():
        other = recovery_cost(model, schedule, (), observations)
        seconds = rate * other.work * count
        captures[name] = (seconds / _SPREAD, seconds * _SPREAD), other.device * count
    return Speed(texels, domain.observations, compiling, phases, *_transfers(), captures)


def make_card(model: ReflectanceModel, side: int) -> Domain:
    """Return a card with bumps, colours, gloss and metal, lit by the upper half of a sphere of lights."""
    across = (np.arange(side) + 0.5) / side - 0.5
    x, y = np.meshgrid(across, across)
    position = np.stack([x, y, np.zeros_like(x)], axis=-1)
    _, slope = wave_field(position, 0.2, 1)
    normal = np.concatenate([-0.25 * slope[..., :2], np.ones((side, side, 1))], axis=-1)
    shade, rough, metal = (wave_values(position, length, seed) for length, seed in ((0.3, 2), (0.4, 3), (0.7, 4)))
    values = {
        "normal": normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        "base_color": np.clip(np.array([0.6, 0.4, 0.25]) * (1 + 0.2 * shade[..., None]), 0.02, 0.95),
        "roughness": np.clip(0.4 + 0.1 * rough, 0.15, 0.9)[..., None],
        "metallic": (metal > 1).astype(float)[..., None],
        "specular": np.full((side, side, 1), 0.5),
    }
    directions = dome(*_LIGHTS)
    lights = np.pad(directions[directions[:, 2] > 0], ((0, 0), (0, 1))).astype(np.float32)
    intensities = np.ones((len(lights), 3), np.float32)
    views = np.tile(np.array([0, 0, 1, 0], np.float32), (len(lights), 1))
    bake = flat_bake(position, np.ones((side, side), bool), position[..., :2] + 0.5)
    values = {name: value.astype(np.float32) for name, value in values.items()}
    with closing(Renderer(bake, model, values, lights, intensities, views, card=True)) as renderer:
        samples = np.stack([renderer.render(k) for k in range(len(lights))])
    return domain_of(bake, samples, lights, intensities, views)


def _timed(domain: Domain, model: ReflectanceModel, schedule: Schedule) -> Iterator[PhaseSpeed]:
    """Yield the phases of a recovery, each measured until the device has finished it."""
    with closing(Recovery(domain, model, schedule)) as recovery:
        progress = recovery.progress
        while not progress.done:
            stage, title, before, started = progress.stage, progress.title, progress.evaluations, time.perf_counter()
            while progress.stage == stage and not progress.done:
                progress = recovery.step(1)
            recovery.mean_error()  # reads back, which waits for the queued work
            renders = (progress.evaluations - before) * domain.observations
            yield PhaseSpeed(title, time.perf_counter() - started, renders)


def _transfers() -> tuple[float, float]:
    """Return the bytes per second of uploads and of downloads, medians of _REPEATS."""
    side = round((_TRANSFER / 16) ** 0.5)
    values, times = np.ones((side, side, 4), np.float32), []
    for _ in range(_REPEATS):
        started = time.perf_counter()
        texture = textures.upload(values)
        uploaded = time.perf_counter()
        textures.download(texture)
        times.append((uploaded - started, time.perf_counter() - uploaded))
    up, down = (values.nbytes / statistics.median(seconds) for seconds in zip(*times, strict=True))
    return up, down
