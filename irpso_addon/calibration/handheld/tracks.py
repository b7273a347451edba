"""Points of a card tracked over photographs: corners of printed markers, or features matched by OpenCV.

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
_PARALLAX = 0.006  # of the diagonal: deviation from the plane's homography by the card's relief
_MIN_MATCHES = 25  # matches that follow one homography
_HUBS = 2  # photographs that are tried as the hub
_TRACKS = 500  # most points, those that most photographs show
_MIN_VIEWS = 3
_MIN_MARKERS = 3  # of a photograph: two, side by side, do not determine the tilt
_VIAS = 10  # photographs to which one that does not match the hub is matched
_SMALL = 900  # pixels: photographs with a shorter longer side are enlarged


@dataclass(frozen=True)
class Tracks:
    """M observations of P points in photographs.

    photograph, point: (M,) numbers. pixels: (M, 2). plane: (P, 2) coordinates of the points in one plane: millimetres
    on a board, y up, or pixels of the photograph ``reference``. used: photographs with observations.
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
        """Return the homography (3, 3) from ``plane`` to the pixels of a photograph."""
        rows = self.photograph == number
        return homography(self.plane[self.point[rows]], self.pixels[rows])


def marker_tracks(codes: Sequence[np.ndarray]) -> Tracks | None:
    """Return the corners of the markers in photographs (H, W) uint8, row 0 at the TOP.

    None for fewer than two photographs with a board. Raises InputError without OpenCV.
    """
    detections = [seen_markers(picture) for picture in codes]
    seen = {n: one for n, one in enumerate(detections) if one is not None and len(one.numbers) >= _MIN_MARKERS}
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
    """Return SIFT features (Lowe 2004) of photographs (H, W) uint8, matched by homographies; None if none match.

    One photograph, the hub, is matched to all others; those that do not match it are matched to those that do.
    """
    cv2 = opencv("finding features of the card")
    places, descriptors = _features(cv2, codes)
    tolerance, count = _PARALLAX * math.hypot(*codes[0].shape), len(codes)

    def matched(number: int, vias: Sequence[int], plane: Sequence[np.ndarray]) -> _Match | None:
        """Match a photograph to others. plane: of each of them, its features' pixels in the hub."""
        pairs = [_best_matches(descriptors[via], descriptors[number]) for via in vias]
        via = np.repeat(vias, [len(first) for first, _ in pairs])
        first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
        if len(first) < _MIN_MATCHES:
            return None
        expected = np.concatenate([at[own] for at, (own, _) in zip(plane, pairs, strict=True)])
        matrix, near = cv2.findHomography(expected, places[number][second], cv2.USAC_MAGSAC, tolerance, maxIters=2000)
        if matrix is None or near.sum() < _MIN_MATCHES:
            return None
        near = near.ravel().astype(bool)
        return _Match(number, via[near], first[near], second[near], expected[near])

    hubs = [(2 * k + 1) * count // (2 * _HUBS) for k in range(_HUBS)]
    candidates = [
        (hub, [found for n in range(count) if n != hub and (found := matched(n, [hub], [places[hub]])) is not None])
        for hub in hubs
    ]
    hub, matches = max(candidates, key=lambda one: len(one[1]))
    if not matches:
        return None
    in_plane = {hub: places[hub]}
    for match in matches:
        inverse = np.linalg.inv(homography(match.plane, places[match.number][match.second]))
        in_plane[match.number] = mapped(inverse, places[match.number])
    vias = [match.number for match in sorted(matches, key=lambda match: -len(match.second))[:_VIAS]]
    for number in sorted(set(range(count)) - set(in_plane)):
        found = matched(number, vias, [in_plane[via] for via in vias])
        matches += [] if found is None else [found]
    return _merged(matches, places, hub)


@dataclass(frozen=True)
class _Match:
    """Matches that satisfy one homography. via: (M,) photographs. first: (M,) their features.

    second: (M,) features of the photograph ``number``. plane: (M, 2) pixels of the hub.
    """

    number: int
    via: np.ndarray
    first: np.ndarray
    second: np.ndarray
    plane: np.ndarray


def _features(cv2: Any, codes: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return pixels (N, 2) and square-rooted descriptors (N, 128) of each photograph's features."""
    detector = cv2.SIFT_create(nfeatures=_FEATURES, contrastThreshold=0.02)
    factor = 2 if max(codes[0].shape) < _SMALL else 1
    places, descriptors = [], []
    for picture in codes:
        height, width = picture.shape
        enlarged = cv2.resize(picture, (width * factor, height * factor), interpolation=cv2.INTER_CUBIC)
        keys, found = detector.detectAndCompute(enlarged, None)
        places.append((np.array([key.pt for key in keys], float).reshape(-1, 2) + 0.5) / factor)
        found = np.zeros((0, 128), np.float32) if found is None else found
        descriptors.append(np.sqrt(found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9)))
    return places, descriptors


def _best_matches(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of features that match mutually and pass the ratio test (Lowe 2004)."""
    if min(len(first), len(second)) < _MIN_MATCHES:
        return np.zeros(0, int), np.zeros(0, int)
    similarity = first @ second.T  # of square-rooted descriptors: 1 − d² / 2 (Arandjelović & Zisserman 2012)
    nearest = similarity.argmax(axis=1)
    best = similarity[np.arange(len(first)), nearest]
    mutual = similarity.argmax(axis=0)[nearest] == np.arange(len(first))
    similarity[np.arange(len(first)), nearest] = -1
    distance, runner_up = (np.sqrt(np.maximum(2 - 2 * values, 0)) for values in (best, similarity.max(axis=1)))
    matches = np.flatnonzero((distance < _RATIO * runner_up) & mutual)
    return matches, nearest[matches]


def _merged(matches: Sequence[_Match], places: Sequence[np.ndarray], hub: int) -> Tracks:
    """Return the tracks of all matches: features that match each other are one point.

    A match that would give a point two features in one photograph is ignored.
    """
    ids: dict[tuple[int, int], int] = {}
    features: list[dict[int, int]] = []  # of each point: photograph → feature
    plane: list[np.ndarray] = []

    def point_of(feature: tuple[int, int], at: np.ndarray) -> int:
        if feature not in ids:
            ids[feature] = len(plane)
            features.append(dict([feature]))
            plane.append(at)
        return ids[feature]

    for match in matches:
        for via, a, b, at in zip(
            match.via.tolist(), match.first.tolist(), match.second.tolist(), match.plane, strict=True
        ):
            first, second = sorted((point_of((via, a), at), point_of((match.number, b), at)))
            if first != second and not features[first].keys() & features[second].keys():
                ids |= dict.fromkeys(features[second].items(), first)
                features[first] |= features[second]
                features[second] = {}
    return _longest(ids, places, np.array(plane), hub)


def _longest(ids: dict[tuple[int, int], int], places: Sequence[np.ndarray], plane: np.ndarray, hub: int) -> Tracks:
    """Return the tracks of the points with the most observations, renumbered."""
    keypoints = {(number, point): key for (number, key), point in ids.items()}
    rows = np.array([(number, point, *places[number][key]) for (number, point), key in keypoints.items()])
    photograph, point = rows[:, 0].astype(int), rows[:, 1].astype(int)
    views = np.bincount(point, minlength=len(plane))
    longest = np.argsort(-views, kind="stable")[:_TRACKS]
    chosen = longest[views[longest] >= _MIN_VIEWS]
    numbers = np.full(len(plane), -1)
    numbers[chosen] = np.arange(len(chosen))
    keep = numbers[point] >= 0
    used = [n for n in np.unique(photograph[keep]) if (photograph[keep] == n).sum() >= _MIN_MATCHES // 2]
    keep &= np.isin(photograph, used)
    return Tracks(
        photograph[keep], numbers[point[keep]], rows[keep, 2:], plane[chosen], tuple(int(n) for n in used), None, hub
    )
