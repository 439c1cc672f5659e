"""The estimators that are compared, under one interface: a task's pairs in, fields of displacement on points out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from correlation_study.scenes import Task
from fringedic.correlation import Reference, measure_displacement

RIVAL_STEP = 17  # [px], shares no factor with the periods of the waves


@dataclass(frozen=True)
class Measured:
    """Displacement (pair, component, row, column) [px] on the points of `rows` and `columns`; NaN where not measured.

    `sigma` is its uncertainty where the estimator states one. `seconds` is the time of all pairs.
    """

    rows: np.ndarray
    columns: np.ndarray
    fields: np.ndarray
    seconds: float = np.nan
    sigma: np.ndarray | None = None

    def inside(self, shape: tuple[int, int], margin: int) -> Measured:
        """The points at least `margin` pixels away from the border of an image of `shape`."""
        r = np.flatnonzero((self.rows >= margin) & (self.rows < shape[0] - margin))
        c = np.flatnonzero((self.columns >= margin) & (self.columns < shape[1] - margin))
        at = np.s_[..., r[0] : r[-1] + 1, c[0] : c[-1] + 1]
        sigma = None if self.sigma is None else self.sigma[at]
        return Measured(self.rows[r], self.columns[c], self.fields[at], self.seconds, sigma)

    def errors(self, task: Task) -> np.ndarray:
        """Measured minus true displacement, in the shape of `fields`."""
        x, y = np.meshgrid(self.columns.astype(float), self.rows.astype(float))
        return self.fields - np.stack([np.stack(motion(x, y)) for motion in task.truth])


def fringedic(task: Task, window: int, spacing: int = 4, method: str = "dense") -> Measured:
    """The library's own estimators; one preparation for all images of a reference."""
    fields, sigmas = [], []
    prepared: tuple[int, Reference] | None = None
    for first, second in task.pairs:
        if prepared is None or prepared[0] != first:
            prepared = first, Reference(task.images[first], window=window, spacing=spacing)
        found = measure_displacement(prepared[1], task.images[second], method=method)
        fields.append(np.stack([found.displacement_x, found.displacement_y]))
        sigmas.append(np.stack([found.sigma_x, found.sigma_y]))
    reference = prepared[1]
    return Measured(reference.rows, reference.columns, np.stack(fields), sigma=np.stack(sigmas))


def _bytes(image: np.ndarray) -> np.ndarray:
    """OpenCV's optical flow takes 8 bits."""
    return image if image.dtype == np.uint8 else np.rint(image / 16).clip(0, 255).astype(np.uint8)


def _every_few(task: Task, flow: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> Measured:
    """`flow(f, g, points (n, 2) as (x, y))` gives the displacement (n, 2) at points on a grid."""
    shape = task.images.shape[1:]
    rows, columns = (np.arange(RIVAL_STEP, n - RIVAL_STEP, RIVAL_STEP) for n in shape)
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    fields = [
        flow(_bytes(task.images[first]), _bytes(task.images[second]), points).T.reshape(2, rows.size, columns.size)
        for first, second in task.pairs
    ]
    return Measured(rows, columns, np.stack(fields))


def pyramidal_lucas_kanade(task: Task, size: int) -> Measured:
    """OpenCV's PyrLK with windows of `size` pixels, iterated until it stands still."""

    def flow(f: np.ndarray, g: np.ndarray, points: np.ndarray) -> np.ndarray:
        start = points.astype(np.float32)[:, None]
        end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
        found, seen, _ = cv2.calcOpticalFlowPyrLK(f, g, start, None, winSize=(size, size), maxLevel=2, criteria=end)
        return np.where(seen, found[:, 0] - start[:, 0], np.nan)

    return _every_few(task, flow)


def dense_inverse_search(task: Task, size: int) -> Measured:
    """OpenCV's DIS on full resolution, patches of `size` pixels every fourth pixel, with its variational smoothing."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(0)
    search.setPatchSize(size)
    search.setPatchStride(4)
    search.setGradientDescentIterations(50)

    def flow(f: np.ndarray, g: np.ndarray, points: np.ndarray) -> np.ndarray:
        return search.calc(f, g, None)[points[:, 1], points[:, 0]]

    return _every_few(task, flow)
