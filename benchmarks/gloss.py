"""How well gloss and metal are recovered from Cycles renders of flat cards and a head: a table, and sheets of pictures.

Usage: python -m benchmarks.gloss [--tune | --report] [--captures lamps,distant,shadows] [--model M] [--set NAME=VALUE]
       [--label L] [--cache .cache/scenes/gloss] [-o OUT] [--keep] [NAME …]
       python -m benchmarks.gloss --table RESULT/gloss.json …
       python -m benchmarks.gloss --check [NAME …]

Cards are 128 × 128 texels, one a pixel, with true base colour, roughness, metallic and a relief that is real geometry.
Four are for choosing settings by (--tune), four only for reporting (--report). ``head`` is a scan with UVs, 256 × 256
texels in pictures of 192 × 192, wet and gilded in places (scenes/head.py), where --data has it; no setting was chosen
by it. Each is photographed by Cycles as

- lamps: 16 near lamps 1.2 to 2 widths away, 15° to 60° off axis, perspective camera; JPEG with noise, 1.5 % clipped;
- distant: 48 distant lights, orthographic camera; EXR without noise;
- shadows: 24 lamps as above, with cast shadows, of a rim around the card too, and four bounces;

and recovered by the public command with the lights given. Errors are of all texels that are recovered, of the head
those that its one camera sees: degrees of normals, absolute differences of maps; base colour also of true metals alone
(metallic > .9), roughness by whether the true one is below .2. A model without a metallic map counts as metallic 0.
PSNR is in sRGB (the Standard view) under 8 lamps that are in no capture: Cycles renders the true card, and the
recovered maps on a flat card pixel for pixel; the head with true and with recovered maps, and only its pixels count.
Highlights are samples with more than 1.5 × the true diffuse part + .02. Pictures stay in the cache, and are rendered
again where a subject or a capture has changed.

--check compares the program's own renderer, given the true maps, with the pictures of each capture, and tells the PSNR
that the true maps themselves have: on the flat card normals within a pixel, which no map holds, are all that they lack.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.scenes import card_captures, cards
from benchmarks.scenes.card_captures import SHOOTINGS, Photographed, Subject
from benchmarks.scenes.command import ROOT, recover
from benchmarks.scenes.gloss_table import Row, coverage, one_run, read_rows, side_by_side
from benchmarks.scenes.head import SCAN, head
from benchmarks.scenes.scores import angles, psnr
from irpso_addon.blender.images import decode
from irpso_addon.blender.scenes.true_surface import TrueMaps
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.capture.read import read_capture
from irpso_addon.core.encode import encode_normal, srgb_from_linear
from irpso_addon.core.paths import DEFAULT_MODEL
from irpso_addon.core.png import encode_png
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps
from irpso_addon.solver.views.forward import rendered

_GLOSSY = 0.2  # roughness below it
_METAL = 0.9  # metallic above it
_SHOWN = {"base_color", "normal", "roughness", "metallic", "specular"}  # parameters that Cycles renders here
_GAP, _ENLARGED = 4, 2  # of a sheet: pixels between pictures, and pixels a texel


def measure(name: str, kind: str, subject: Subject, options: argparse.Namespace) -> Row:
    """Photograph a subject, recover it, write its sheet, and return its errors."""
    shot = card_captures.photograph(f"{name}-{kind}", subject, SHOOTINGS[kind], options.cache)
    out = options.out / f"{name}-{kind}"
    settings = [part for setting in options.set for part in ("--set", setting)]
    preset = ["--preset", options.preset] if options.preset else []
    seconds = recover(shot.capture, out, *shot.arguments, "--model", options.model, *preset, *settings)
    maps = recovered_maps(out, options.model)
    pictures, as_seen = card_captures.relight(subject, maps, SHOOTINGS[kind].near, out / "relit")
    row = {"card": name, "capture": kind, **_how(options)}
    (coverage,) = read_exr(out / "maps.exr")["coverage"].values()
    row |= errors(maps, shot.truth, coverage > 0) | outlier_shares(maps, shot.truth, coverage > 0, out)
    row |= picture_errors(pictures, shot) | {"seconds": seconds}
    encode_png(options.out / f"{name}-{kind}.png", sheet(as_seen, pictures, shot), bits=8)
    if not options.keep:
        shutil.rmtree(out)
    return row


def _how(options: argparse.Namespace) -> Row:
    return {"label": options.label, "model": options.model, "preset": options.preset, "set": options.set}


def recovered_maps(out: Path, name: str) -> TrueMaps:
    """Return a result's maps for Cycles: matt if the model has no roughness, dielectric if it has no metallic."""
    model = load_model(name)
    if unknown := {p.name for p in model.parameters} - _SHOWN:
        raise SystemExit(f"{name}: Cycles is not shown {', '.join(sorted(unknown))} here; choose a Principled model")
    values = read_maps(out, model)
    shape = values["normal"].shape[:2]
    maps = {key: value[..., 0] for key, value in values.items() if value.shape[-1] == 1}
    if "roughness" not in maps:
        maps |= {"roughness": np.ones(shape), "specular": np.zeros(shape)}
    maps.setdefault("metallic", np.zeros(shape))
    return TrueMaps(values["base_color"], values["normal"], **maps)


def errors(maps: TrueMaps, truth: TrueMaps, seen: np.ndarray) -> Row:
    """Return the errors of maps over the texels seen (H, W); None where a subject has none of a kind."""
    turned = angles(maps.normal, truth.normal)[seen]
    colour = np.abs(maps.base_color - truth.base_color).mean(axis=-1)
    rough = np.abs(maps.roughness - truth.roughness)
    glossy, metal = truth.roughness < _GLOSSY, truth.metallic > _METAL
    return {
        "normal_mean": _of(np.mean, turned),
        "normal_median": _of(np.median, turned),
        "base_color": _of(np.mean, colour[seen]),
        "base_color_metal": _of(np.mean, colour[seen & metal]),
        "metallic": _of(np.mean, np.abs(maps.metallic - truth.metallic)[seen]),
        "roughness_glossy": _of(np.mean, rough[seen & glossy]),
        "roughness_glossy_median": _of(np.median, rough[seen & glossy]),
        "roughness_matt": _of(np.mean, rough[seen & ~glossy]),
        "roughness_matt_median": _of(np.median, rough[seen & ~glossy]),
    }


def outlier_shares(maps: TrueMaps, truth: TrueMaps, seen: np.ndarray, out: Path) -> Row:
    """Return, for each map, the share of the seen texels whose error exceeds three reported standard deviations.

    A colour counts if one of its channels does.
    """
    layers = read_exr(out / "confidence.exr")
    wrong = {"normal": np.radians(angles(maps.normal, truth.normal))[..., None]}
    for name in ("base_color", "metallic", "roughness"):
        wrong[name] = np.abs(np.atleast_3d(getattr(maps, name)) - np.atleast_3d(getattr(truth, name)))
    shares = {}
    for name, error in wrong.items():
        deviation = layers.get(f"confidence_{name}")
        if deviation is None:
            shares[f"beyond_{name}"] = None
            continue
        channels = [deviation[c] for c in sorted(deviation, reverse=True)]  # R, G, B; a file has them as B, G, R
        over = (error > 3 * np.stack(channels, axis=-1)).any(axis=-1)
        shares[f"beyond_{name}"] = float(over[seen].mean())
    return shares


def _of(summary, values: np.ndarray) -> float | None:
    return float(summary(values)) if values.size else None


def picture_errors(pictures: np.ndarray, shot: Photographed) -> Row:
    """Return the PSNR of relit pictures (8, H, W, 3) over the subject's samples, and over those in highlights."""
    lit, shown_at = highlights(shot) & shot.shown, np.broadcast_to(shot.shown, (len(pictures), *shot.shown.shape))
    shown, true = (srgb_from_linear(np.clip(p, 0, 1)) for p in (pictures, shot.unseen))
    return {
        "psnr": psnr(shown, true, shown_at),
        "psnr_highlights": psnr(shown, true, lit) if lit.any() else None,
        "highlights": float(lit[shown_at].mean()),
    }


def highlights(shot: Photographed) -> np.ndarray:
    """Return (8, H, W) bool: where the true picture is much brighter than its diffuse part."""
    return shot.unseen.mean(axis=-1) > 1.5 * card_captures.diffuse_part(shot) + 0.02


def sheet(as_seen: TrueMaps, pictures: np.ndarray, shot: Photographed) -> np.ndarray:
    """Return a picture: above the truth, below the recovery; base colour, metallic, roughness, normal, relit.

    as_seen: the recovered maps as the camera sees them. Relit under the unseen lamp with the most highlights.
    """
    lamp = int(highlights(shot).sum(axis=(1, 2)).argmax())
    rows = []
    for maps, picture in ((as_seen, pictures[lamp]), (shot.as_seen, shot.unseen[lamp])):
        grey = (np.repeat(values[..., None], 3, axis=-1) for values in (maps.metallic, maps.roughness))
        colour, relit = srgb_from_linear(np.clip(maps.base_color, 0, 1)), srgb_from_linear(np.clip(picture, 0, 1))
        rows.append(np.concatenate([_framed(p) for p in (colour, *grey, encode_normal(maps.normal), relit)], axis=1))
    return np.concatenate(rows)


def _framed(picture: np.ndarray) -> np.ndarray:
    large = picture.repeat(_ENLARGED, axis=0).repeat(_ENLARGED, axis=1)
    return np.pad(large, [(_GAP, _GAP), (_GAP, _GAP), (0, 0)], constant_values=0.5)


def forward_error(subject: Subject, shot: Photographed, shadows: bool) -> tuple[float, float, float]:
    """Return quantiles .5, .9 of the texels' relative error of the program's renderer with the true maps, and its bias.

    A texel's error is the mean over its samples that are not clipped of |ours − theirs|, over the mean of theirs; the
    bias is the median over the texels of the signed one.
    """
    domain = subject.domain(read_capture(shot.capture, decoder=decode), shadows)
    truth = {
        name: np.atleast_3d(getattr(shot.truth, name)) for name in ("base_color", "normal", "roughness", "metallic")
    }
    model = load_model("principled_metallic")
    ours = np.stack([p[..., :3] for p in rendered(domain, model, truth, range(domain.observations))])
    samples = np.stack(list(domain.stack.layers()))
    valid = samples[..., 3:] > 0
    residual, theirs = (ours - samples[..., :3]) * valid, samples[..., :3] * valid
    whole = theirs.sum(axis=(0, 3))
    share, signed = ((a.sum(axis=(0, 3)) / whole)[whole > 0] for a in (np.abs(residual), residual))
    return float(np.median(share)), float(np.quantile(share, 0.9)), float(np.median(signed))


def check(names: list[str], kinds: list[str], table: dict, options: argparse.Namespace) -> None:
    """Print the errors of the program's renderer against Cycles, and the PSNR of the true maps."""
    print("| card | capture | error of texels, median | 90 % | signed, median | PSNR dB of true maps | of highlights |")
    print("|---|---|---|---|---|---|---|")
    for kind in kinds:
        for name in names:
            subject, shooting = table[name](), SHOOTINGS[kind]
            shot = card_captures.photograph(f"{name}-{kind}", subject, shooting, options.cache)
            percentages = " | ".join(f"{100 * v:.2f} %" for v in forward_error(subject, shot, shooting.shadows))
            with TemporaryDirectory() as folder:
                shown, _ = card_captures.relight(subject, shot.truth, shooting.near, Path(folder))
            best = picture_errors(shown, shot)
            psnrs = [f"{value:.1f}" if value is not None else "–" for value in (best["psnr"], best["psnr_highlights"])]
            print(f"| {name} | {kind} | {percentages} | {' | '.join(psnrs)} |", flush=True)


def main() -> None:
    """Print the table, and write it with its numbers and sheets into the output folder."""
    options = _parser().parse_args()
    if options.table:
        print(side_by_side(options.table))
        return
    tune, report = cards.card_table(options.data)
    scan = options.data / SCAN
    table = tune | report | ({"head": partial(head, scan)} if scan.is_dir() else {})
    chosen = options.names or list(tune if options.tune else report if options.report else table)
    kinds = options.captures.split(",")
    for requested, available in ((chosen, table), (kinds, SHOOTINGS)):
        if unknown := set(requested) - set(available):
            raise SystemExit(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(available)}")
    if options.check:
        check(chosen, kinds, table, options)
        return
    options.label = options.label or options.model
    options.out = options.out or options.cache / "results" / options.label
    options.out.mkdir(parents=True, exist_ok=True)
    print(one_run(measure_all(chosen, kinds, table, options)))


def measure_all(names: list[str], kinds: list[str], table: dict, options: argparse.Namespace) -> list[Row]:
    """Measure every card in every capture and write the tables; return all rows of the output folder.

    Rows of other cards and captures in the folder's gloss.json stay if their settings are the same.
    """
    path, rows = options.out / "gloss.json", {}
    if path.exists():
        former = [row for row in read_rows(path) if row.items() >= _how(options).items()]
        rows = {(row["card"], row["capture"]): row for row in former}
    for kind in kinds:
        for name in names:
            rows[name, kind] = measure(name, kind, table[name](), options)
            sys.stderr.write(f"{one_run([rows[name, kind]]).splitlines()[-1]}\n")
            path.write_text(json.dumps(list(rows.values()), indent=1), encoding="utf-8")
    tables = f"{one_run(list(rows.values()))}\n\n{coverage(list(rows.values()))}\n"
    (options.out / "gloss.md").write_text(tables, encoding="utf-8")
    return list(rows.values())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="cards, or head; all without")
    half = parser.add_mutually_exclusive_group()
    half.add_argument("--tune", action="store_true", help="only the cards that settings are chosen by")
    half.add_argument("--report", action="store_true", help="only the cards that no setting was chosen by")
    parser.add_argument("--captures", default="lamps,distant,shadows", help="which of them, and in which order")
    parser.add_argument("--model", default=DEFAULT_MODEL, help="of recover")
    parser.add_argument("--preset", help="of recover")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="of recover; repeatable")
    parser.add_argument("--label", help="name of this run in tables (default: the model)")
    data = ROOT.parent / "shared" / "data"
    parser.add_argument(
        "--data", type=Path, default=data, help="folder that may hold materials/rock/albedo.jpg and the scan"
    )
    cache = ROOT / ".cache" / "scenes" / "gloss"
    parser.add_argument("--cache", type=Path, default=cache, help="folder that keeps the pictures")
    parser.add_argument(
        "-o", "--out", type=Path, help="folder for table and sheets (default: results/LABEL, in the cache)"
    )
    parser.add_argument("--keep", action="store_true", help="keep what recover wrote, beside the sheets")
    parser.add_argument("--table", type=Path, nargs="+", metavar="FILE", help="print gloss.json of several runs")
    parser.add_argument("--check", action="store_true", help="compare the program's renderer with Cycles, and end")
    return parser


if __name__ == "__main__":
    main()
