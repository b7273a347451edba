"""Points of a card that several photographs show: corners of printed markers, or features matched by OpenCV.

Pixels count from the UPPER left corner of a photograph, to the right and down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...capture.frame.board import Board
from ...capture.frame.homography import homography, mapped
from ...capture.frame.markers import seen_markers
from ...core.opencv import opencv

_FEATURES = 2500  # of a photograph
_RATIO = 0.8  # best over second-best distance of descriptors (Lowe 2004)
_PARALLAX = 0.006  # of the diagonal: how far a point of the card's relief may be from its plane's homography
_FEWEST = 25  # matches that follow one homography
_HUBS = 2  # photographs that are tried as the one that all others are matched to
_TRACKS = 500  # points that are kept, those that most photographs show
_LEAST_VIEWS = 3
_LEAST_MARKERS = 3  # of a photograph: two, side by side, tell no tilt
_VIAS = 10  # photographs that one which does not match the hub is matched to
_SMALL = 900  # pixels of the longer side below which pictures are enlarged


@dataclass(frozen=True)
class Tracks:
    """Points seen in photographs. One row for each time that a photograph shows a point.

    photograph, point: (M,) numbers. pixels: (M, 2). plane: (P, 2) places of the points in one plane: millimetres on a
    board, y up, or pixels of the photograph ``reference``. used: photographs in which points were found.
    """

    photograph: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    plane: np.ndarray
    used: tuple[int, ...]
    board: Board | None = None
    reference: int = -1

    def without(self, numbers: Sequence[int]) -> Tracks:
        """Return the tracks without some photographs."""
        keep = ~np.isin(self.photograph, numbers)
        return replace(
            self, photograph=self.photograph[keep], point=self.point[keep], pixels=self.pixels[keep],
            used=tuple(n for n in self.used if n not in numbers),
        )  # fmt: skip

    def homography(self, number: int) -> np.ndarray:
        """Return (3, 3) from ``plane`` to the pixels of a photograph."""
        own = self.photograph == number
        return homography(self.plane[self.point[own]], self.pixels[own])


def marker_tracks(codes: Sequence[np.ndarray]) -> Tracks | None:
    """Return the corners of the markers that photographs (H, W) uint8 show, row 0 at the TOP; None for fewer than two
    photographs with a board. Raises InputError without OpenCV."""
    found = [seen_markers(picture) for picture in codes]
    seen = {n: one for n, one in enumerate(found) if one is not None and len(one.numbers) >= _LEAST_MARKERS}
    if len(seen) < 2:
        return None
    boards = [one.board for one in seen.values()]
    board = max(boards, key=boards.count)
    seen = {n: one for n, one in seen.items() if one.board == board}
    order = list(board.markers)
    plane = np.concatenate([board.markers[number] for number in order])
    point = [
        np.concatenate([4 * order.index(marker) + np.arange(4) for marker in one.numbers]) for one in seen.values()
    ]
    return Tracks(
        np.repeat(list(seen), [len(p) for p in point]), np.concatenate(point),
        np.concatenate([one.pixels for one in seen.values()]), plane, tuple(seen), board,
    )  # fmt: skip


def feature_tracks(codes: Sequence[np.ndarray]) -> Tracks | None:
    """Return SIFT features (Lowe 2004) of photographs (H, W) uint8, matched along homographies; None without any.

    One photograph is the hub that others are matched to; those that do not match it are matched to those that do.
    """
    cv2 = opencv("finding features of the card")
    places, marks = _features(cv2, codes)
    reach, count = _PARALLAX * math.hypot(*codes[0].shape), len(codes)

    def matched(number: int, vias: Sequence[int], plane: Sequence[np.ndarray]) -> _Match | None:
        """Match a photograph to others; plane: for each of them, where its features lie in the hub's picture."""
        pairs = [_alike(marks[via], marks[number]) for via in vias]
        via = np.repeat(vias, [len(first) for first, _ in pairs])
        first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
        if len(first) < _FEWEST:
            return None
        there = np.concatenate([at[own] for at, (own, _) in zip(plane, pairs, strict=True)])
        matrix, near = cv2.findHomography(there, places[number][second], cv2.USAC_MAGSAC, reach, maxIters=2000)
        if matrix is None or near.sum() < _FEWEST:
            return None
        near = near.ravel().astype(bool)
        return _Match(number, via[near], first[near], second[near], there[near])

    hubs = [(2 * k + 1) * count // (2 * _HUBS) for k in range(_HUBS)]
    tried = [
        (hub, [found for n in range(count) if n != hub and (found := matched(n, [hub], [places[hub]])) is not None])
        for hub in hubs
    ]
    hub, matches = max(tried, key=lambda one: len(one[1]))
    if not matches:
        return None
    in_plane = {hub: places[hub]}
    for match in matches:
        back = np.linalg.inv(homography(match.plane, places[match.number][match.second]))
        in_plane[match.number] = mapped(back, places[match.number])
    vias = [match.number for match in sorted(matches, key=lambda match: -len(match.second))[:_VIAS]]
    for number in sorted(set(range(count)) - set(in_plane)):
        found = matched(number, vias, [in_plane[via] for via in vias])
        matches += [] if found is None else [found]
    return _merged(matches, places, hub)


@dataclass(frozen=True)
class _Match:
    """Features of a photograph that lie where others say. via: (M,) photographs. first: (M,) features of these.

    second: (M,) features of the photograph ``number``. plane: (M, 2) pixels of the hub.
    """

    number: int
    via: np.ndarray
    first: np.ndarray
    second: np.ndarray
    plane: np.ndarray


def _features(cv2: Any, codes: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return places (N, 2) and descriptors (N, 128) of each photograph's features."""
    detector = cv2.SIFT_create(nfeatures=_FEATURES, contrastThreshold=0.02)
    factor = 2 if max(codes[0].shape) < _SMALL else 1
    places, marks = [], []
    for picture in codes:
        height, width = picture.shape
        larger = cv2.resize(picture, (width * factor, height * factor), interpolation=cv2.INTER_CUBIC)
        keys, found = detector.detectAndCompute(larger, None)
        places.append((np.array([key.pt for key in keys], float).reshape(-1, 2) + 0.5) / factor)
        found = np.zeros((0, 128), np.float32) if found is None else found
        marks.append(np.sqrt(found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9)))
    return places, marks


def _alike(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers of features that are each other's best match, clearly better than the second best."""
    if min(len(first), len(second)) < _FEWEST:
        return np.zeros(0, int), np.zeros(0, int)
    likeness = first @ second.T  # of square-rooted descriptors: 1 − d² / 2 (Arandjelović & Zisserman 2012)
    nearest = likeness.argmax(axis=1)
    best = likeness[np.arange(len(first)), nearest]
    mutual = likeness.argmax(axis=0)[nearest] == np.arange(len(first))
    likeness[np.arange(len(first)), nearest] = -1
    far, farther = (np.sqrt(np.maximum(2 - 2 * values, 0)) for values in (best, likeness.max(axis=1)))
    good = np.flatnonzero((far < _RATIO * farther) & mutual)
    return good, nearest[good]


def _merged(matches: Sequence[_Match], places: Sequence[np.ndarray], hub: int) -> Tracks:
    """Return the points of all matches: features that match each other are one."""
    ids: dict[tuple[int, int], int] = {}
    plane: list[np.ndarray] = []
    for match in matches:
        for via, a, b, at in zip(
            match.via.tolist(), match.first.tolist(), match.second.tolist(), match.plane, strict=True
        ):
            if (via, a) not in ids:
                ids[via, a] = len(plane)
                plane.append(at)
            ids.setdefault((match.number, b), ids[via, a])
    return _kept(ids, places, np.array(plane), hub)


def _kept(ids: dict[tuple[int, int], int], places: Sequence[np.ndarray], plane: np.ndarray, hub: int) -> Tracks:
    """Return the points that most photographs show, numbered anew."""
    once = {(number, point): key for (number, key), point in ids.items()}
    rows = np.array([(number, point, *places[number][key]) for (number, point), key in once.items()])
    photograph, point = rows[:, 0].astype(int), rows[:, 1].astype(int)
    views = np.bincount(point, minlength=len(plane))
    most = np.argsort(-views, kind="stable")[:_TRACKS]
    chosen = most[views[most] >= _LEAST_VIEWS]
    new = np.full(len(plane), -1)
    new[chosen] = np.arange(len(chosen))
    keep = new[point] >= 0
    used = [n for n in np.unique(photograph[keep]) if (photograph[keep] == n).sum() >= _FEWEST // 2]
    keep &= np.isin(photograph, used)
    return Tracks(
        photograph[keep], new[point[keep]], rows[keep, 2:], plane[chosen], tuple(int(n) for n in used), None, hub
    )
