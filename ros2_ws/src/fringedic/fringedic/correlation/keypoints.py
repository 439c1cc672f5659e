"""Start for motions that translations do not lead to: large rotations and strains, from keypoints of both images.

Scale-invariant keypoints of the texture are matched by their descriptors, and the affine motion that most of the
matches agree on is found by random samples. Neither depends on how far the surface moves, turns or stretches.

References
----------
D. G. Lowe (2004), Distinctive image features from scale-invariant keypoints, IJCV 60, 91-110.
M. A. Fischler, R. C. Bolles (1981), Random sample consensus, Communications of the ACM 24, 381-395.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from fringedic.correlation.pyramid import find_level

WIDEST = 1600  # [px] of the level that is used: keypoints of more pixels need gigabytes and find nothing else
MOST_KEYPOINTS = 5000  # the strongest of each image
DISTINCT = 0.85  # largest ratio of the distances of descriptors to the nearest and to the second keypoint
TOLERANCE = 4.0  # [px of the level] between a match and the motion; the strain of a specimen is not uniform
_MOST_SAMPLES = 5000
_CERTAINTY = 0.9999
_RANGE = (0.5, 99.5)  # percentiles of the grey levels that become 0 and 255
FALSE_ALARM = 1e-6  # of a motion that matches without any relation agree on


def match_keypoints(reference: list[np.ndarray], deformed: list[np.ndarray]) -> np.ndarray | None:
    """Return the affine motion (2, 3) [px of the full image] that most keypoints agree on.

    Parameters
    ----------
    reference, deformed
        Pyramids of grey levels (row, column), finest first; NaN where nothing is known.

    Returns
    -------
    ndarray or None
        Displacement at the corner pixel (0, 0) and its derivatives by x and by y; None where so few matches agree that
        matches without any relation would do so with a probability above `FALSE_ALARM`.
    """
    k = find_level(reference, WIDEST)
    detector = cv2.SIFT.create(nfeatures=MOST_KEYPOINTS)
    places, descriptors = [], []
    for image in (reference[k], deformed[k]):
        found, described = detector.detectAndCompute(_as_bytes(image), None)
        places.append(np.array([each.pt for each in found], np.float32).reshape(-1, 2))
        descriptors.append(described)
    if min(len(each) for each in places) < 2:
        return None
    pairs = [
        first
        for first, second in cv2.BFMatcher.create().knnMatch(descriptors[0], descriptors[1], k=2)
        if first.distance < DISTINCT * second.distance
    ]
    # Each place counts once in each image: keypoints may have several directions, and many that resemble one other.
    matches = [(each.queryIdx, each.trainIdx) for each in pairs]
    for i in (1, 0):
        matches = list({places[i][match[i]].tobytes(): match for match in matches}.values())
    if len(matches) < 3:
        return None
    before, after = (places[i][[match[i] for match in matches]] for i in (0, 1))
    affine, agreed = cv2.estimateAffine2D(
        before, after, ransacReprojThreshold=TOLERANCE, maxIters=_MOST_SAMPLES, confidence=_CERTAINTY
    )
    if affine is None or int(agreed.sum()) < _fewest_matches(len(matches), reference[k].size):
        return None
    gradient = affine[:, :2] - np.eye(2)
    scale = 2**k  # pixel p of level k is at scale * (p + 1/2) - 1/2 in the full image
    corner = scale * affine[:, 2] - 0.5 * (scale - 1) * gradient.sum(axis=1)
    return np.column_stack([corner, gradient])


def _fewest_matches(number: int, pixels: int) -> int:
    """Return how many of so many matches agree on one of the tried motions by chance with less than `FALSE_ALARM`.

    Three matches define a motion. Each other one agrees with it by chance in the share of the image that the tolerance
    covers, a binomial distribution, of which the sum of the probabilities beyond k is below the bound of Chernoff.
    """
    chance = min(0.5, math.pi * TOLERANCE**2 / pixels)
    level = math.log(FALSE_ALARM / _MOST_SAMPLES)
    others = max(number - 3, 1)
    for k in range(1, others):
        part = k / others
        bound = -others * (part * math.log(part / chance) + (1 - part) * math.log((1 - part) / (1 - chance)))
        if part > chance and bound < level:
            return k + 3
    return number + 1


def _as_bytes(image: np.ndarray) -> np.ndarray:
    """Return grey levels as 8 bits; the mean where nothing is known."""
    known = np.isfinite(image)
    if not known.any():
        return np.zeros(image.shape, np.uint8)
    low, high = np.percentile(image[known], _RANGE)
    levels = (np.where(known, image, image[known].mean()) - low) * (255 / max(high - low, 1e-12))
    grey: np.ndarray = np.clip(levels, 0, 255).astype(np.uint8)
    return grey
