"""Compiled ray tracing of the virtual rig: pin-holes, surfaces, strokes, the exact solution of every camera pixel.

All kernels that call each other are in this one file on purpose: Numba's on-disk cache detects a change of the file
that defines a kernel, but not of the files that the kernel calls into.

Lengths are in metre and image coordinates in pixel. A surface is a function of the material coordinates (X, Y) and of
the crosshead position; (X, Y) is the position of the material point in the undeformed planform.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

# Elementwise only, so that results do not depend on the number of threads. Error model of NumPy: a search that leaves
# the surface ends in NaN and not in an exception.
compiled = njit(cache=True, nogil=True, error_model="numpy")
in_parallel = njit(cache=True, nogil=True, error_model="numpy", parallel=True)

RIGID, PLATE, SKIN, LEATHER, REFERENCE_PLANE, CYLINDER, SPHERES = 0, 1, 2, 3, 4, 5, 6
PLANE, SPHERE, STEPPED, BALLS = 0, 1, 2, 3

# A stroke ends where its Gaussian has fallen to exp(-STROKE_REACH / 2) = 5e-5 of its height. This foot is subtracted
# from the whole stroke, so that surface and texture are continuous there.
STROKE_REACH = 20.0
STROKE_FOOT = math.exp(-0.5 * STROKE_REACH)
# Half step of the central differences [m]: truncation and rounding errors are both near 1e-10 for details of 0.2 mm.
HALF_STEP = 1e-7
CONVERGED = 1e-9  # [px]


class StrokeField(NamedTuple):
    """Anisotropic Gaussian strokes with a cell list: each cell lists the strokes that reach into it.

    Attributes
    ----------
    strokes : float64 array (n, 6)
        Centre X, Y [m]; A, B, C [1/m^2] of A dX^2 + 2 B dX dY + C dY^2; height.
    start, items : int64 array (cells + 1,), int32 array
        Compressed lists: the strokes of cell i are ``items[start[i]:start[i + 1]]``.
    grid : float64 array (3,)
        Lower corner X, Y and edge length of the cells [m].
    cells : int64 array (2,)
        Number of cells along Y and X.
    """

    strokes: np.ndarray
    start: np.ndarray
    items: np.ndarray
    grid: np.ndarray
    cells: np.ndarray


class DeformedSurface(NamedTuple):
    """The surface of a specimen at one crosshead position.

    Attributes
    ----------
    kind : int
        Which surface function.
    coefficients : float64 array
        Its parameters.
    position : float
        Crosshead position [m].
    placed : bool
        Whether the frame of the specimen is not that of the sensor.
    pose : float64 array (12,)
        Rotation, row-major, and translation [m] from the frame of the specimen to that of the sensor.
    strokes, start, items, grid, cells
        Relief, strokes of height [m] added to z, see `StrokeField`; not nested, because Numba does not take nested
        tuples into parallel loops.
    """

    kind: int
    coefficients: np.ndarray
    position: float
    placed: bool
    pose: np.ndarray
    strokes: np.ndarray
    start: np.ndarray
    items: np.ndarray
    grid: np.ndarray
    cells: np.ndarray


class LightMaps(NamedTuple):
    """Maps (row, column) that `light_geometry` fills: projector column and row [px], irradiance, facing cosine [-]."""

    column: np.ndarray
    row: np.ndarray
    irradiance: np.ndarray
    facing: np.ndarray


class ShadowSearch(NamedTuple):
    """Limits of the search for shadows.

    Attributes
    ----------
    outline : float64 array (4,)
        First and last X, first and last Y [m] of the specimen.
    top : float
        Largest height of the specimen [m].
    stride : float
        Length of a step in plan [m].
    """

    outline: np.ndarray
    top: float
    stride: float


@compiled
def stroke_sum(field, X, Y):
    """Return the sum of all strokes at (X, Y) and its derivatives along X and Y."""
    value = 0.0
    slope_x = 0.0
    slope_y = 0.0
    i = math.floor((Y - field.grid[1]) / field.grid[2])
    j = math.floor((X - field.grid[0]) / field.grid[2])
    if 0 <= i < field.cells[0] and 0 <= j < field.cells[1]:
        cell = i * field.cells[1] + j
        for k in range(field.start[cell], field.start[cell + 1]):
            n = field.items[k]
            dx = X - field.strokes[n, 0]
            dy = Y - field.strokes[n, 1]
            px = field.strokes[n, 2] * dx + field.strokes[n, 3] * dy
            py = field.strokes[n, 3] * dx + field.strokes[n, 4] * dy
            q = px * dx + py * dy
            if q < STROKE_REACH:
                g = math.exp(-0.5 * q)
                height = field.strokes[n, 5]
                value += height * (g - STROKE_FOOT)
                slope_x -= height * g * px
                slope_y -= height * g * py
    return value, slope_x, slope_y


@compiled
def fill_cells(strokes, extent, grid, cells, start, items):
    """List the strokes of every cell; with empty ``items`` only count them into ``start[cell + 1]``.

    A stroke is left out of the cells in the corners of its bounding box (half size ``extent``) that its ellipse does
    not reach.
    """
    counting = items.size == 0
    position = start[:-1].copy()
    for n in range(strokes.shape[0]):
        x, y, a, b, c = strokes[n, 0], strokes[n, 1], strokes[n, 2], strokes[n, 3], strokes[n, 4]
        steepest = 0.5 * (a + c) + math.sqrt(0.25 * (a - c) * (a - c) + b * b)
        reach = math.sqrt(STROKE_REACH) + grid[2] * math.sqrt(0.5 * steepest)
        first_j = max(math.floor((x - extent[n, 0] - grid[0]) / grid[2]), 0)
        last_j = min(math.floor((x + extent[n, 0] - grid[0]) / grid[2]), cells[1] - 1)
        first_i = max(math.floor((y - extent[n, 1] - grid[1]) / grid[2]), 0)
        last_i = min(math.floor((y + extent[n, 1] - grid[1]) / grid[2]), cells[0] - 1)
        for i in range(first_i, last_i + 1):
            for j in range(first_j, last_j + 1):
                dx = grid[0] + (j + 0.5) * grid[2] - x
                dy = grid[1] + (i + 0.5) * grid[2] - y
                if a * dx * dx + 2.0 * b * dx * dy + c * dy * dy > reach * reach:
                    continue
                cell = i * cells[1] + j
                if counting:
                    start[cell + 1] += 1
                else:
                    items[position[cell]] = n
                    position[cell] += 1


# Surfaces ------------------------------------------------------------------------------------------------------------


@compiled
def _rise(x):
    return 0.5 * (1.0 + math.tanh(x))


@compiled
def _rigid_point(c, position, X, Y):
    """Return a point of a rigid shape c[0] with parameters c[1:6].

    It moves by c[6:9] and rotates by the rotation vector c[9:12] per metre of the crosshead.
    """
    if c[0] == PLANE:  # height, slopes along X and Y
        z = c[1] + c[2] * X + c[3] * Y
    elif c[0] == SPHERE:  # height of the apex, radius
        z = c[1] - c[2] + math.sqrt(max(c[2] * c[2] - X * X - Y * Y, 0.0))
    elif c[0] == BALLS:  # height of the base, radius, half the distance of the balls, depth of their centres below it
        beside = abs(X) - c[3]
        z = c[1] + max(math.sqrt(max(c[2] * c[2] - beside * beside - Y * Y, 0.0)) - c[4], 0.0)
    else:  # base height, block height, transition length, half width of the block, Y of the second step
        block = _rise((X + c[4]) / c[3]) - _rise((X - c[4]) / c[3])
        z = c[1] + c[2] * (block + 0.5 * _rise((Y - c[5]) / c[3]))
    wx, wy, wz = c[9] * position, c[10] * position, c[11] * position
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    # Rodrigues' formula with sin(a)/a and (1 - cos(a))/a^2 written so that they stay exact at small angles
    if angle > 1e-12:
        s = math.sin(angle) / angle
        half = math.sin(0.5 * angle) / angle
        v = 2.0 * half * half
    else:
        s, v = 1.0, 0.5
    kx, ky, kz = wy * z - wz * Y, wz * X - wx * z, wx * Y - wy * X
    kkx, kky, kkz = wy * kz - wz * ky, wz * kx - wx * kz, wx * ky - wy * kx
    return (
        X + s * kx + v * kkx + c[6] * position,
        Y + s * ky + v * kky + c[7] * position,
        z + s * kz + v * kkz + c[8] * position,
    )


@compiled
def _plate_point(c, position, X, Y):
    """Return a point of a plate in uniform tension along y with Poisson contraction, whose bow straightens."""
    length, poisson, bow, straightening, slope_x, slope_y, twist = c[0], c[1], c[2], c[3], c[4], c[5], c[6]
    strain = position / length
    remaining = bow / (1.0 + position / straightening)
    t = 2.0 * Y / length
    return (
        X * (1.0 - poisson * strain),
        Y + strain * (Y + 0.5 * length),
        slope_x * X + slope_y * Y + remaining * (1.0 - t * t) * (1.0 + twist * X),
    )


@compiled
def _skin_point(c, position, X, Y):
    """Return a point of skin pulled along +y by a pad; anisotropy tilts the strain band and adds a lateral drift."""
    radius_x, radius_y, length, reach, poisson = c[0], c[1], c[2], c[3], c[4]
    tilt, drift, dip = c[5], c[6], c[7]
    t = math.tanh((Y + tilt * X) / length)
    band = 1.0 - t * t
    fall = math.exp(-0.5 * X * X / (reach * reach))
    return (
        X + position * fall * (drift * band - poisson * 0.5 * band / length * X),
        Y + position * fall * 0.5 * (1.0 + t),
        -0.5 * X * X / radius_x - 0.5 * Y * Y / radius_y - position * dip * band * fall,
    )


@compiled
def _leather_point(c, position, X, Y):
    """Return a point of a fold A sech^2(s/a) that fans out from a screw, flattens without stretching, and turns.

    Flattening does not stretch to second order. It releases the arc length
    int (z'^2 - z'_0^2)/2 ds = 2 (A_0^2 - A^2)/a (t^3/3 - t^5/5), t = tanh(s/a), which pushes both sides of the fold
    apart.
    """
    height, width, across_x, across_y = c[0], c[1], c[2], c[3]
    fold_x, fold_y, screw_x, screw_y = c[4], c[5], c[6], c[7]
    growth, flattening, rotation, stretch, curvature, lift = c[8], c[9], c[10], c[11], c[12], c[13]
    s = (X - fold_x) * across_x + (Y - fold_y) * across_y
    along = (Y - screw_y) * across_x - (X - screw_x) * across_y
    t = math.tanh(s / width)
    initial = height * _rise(along / growth)
    present = initial * math.exp(-position / flattening)
    opening = 2.0 * (initial * initial - present * present) / width * t * t * t * (1.0 / 3.0 - t * t / 5.0)
    x = X + opening * across_x - screw_x
    y = Y + opening * across_y - screw_y + stretch * position * (Y - screw_y)
    turn = rotation * position
    distance = (X - screw_x) * (X - screw_x) + (Y - screw_y) * (Y - screw_y)
    return (
        screw_x + math.cos(turn) * x - math.sin(turn) * y,
        screw_y + math.sin(turn) * x + math.cos(turn) * y,
        present * (1.0 - t * t) + 0.5 * (curvature + lift * position) * distance,
    )


@compiled
def _cylinder_point(c, position, X, Y):
    """Return a point of a cylinder about y in tension, torsion and bulging; X is the arc length from its crest."""
    radius, length, poisson, twist, bulge = c[0], c[1], c[2], c[3], c[4]
    strain = position / length
    t = 2.0 * Y / length
    present = radius * (1.0 - poisson * strain) + bulge * position * (1.0 - t * t)
    angle = X / radius + twist * position * (Y + 0.5 * length)
    return present * math.sin(angle), Y + strain * (Y + 0.5 * length), present * math.cos(angle)


@compiled
def _spheres_point(c, X, Y):
    """Return a point of one of several spheres side by side in X: radius, width of each, then their centres.

    X and Y are arc lengths along the equator around y, and along a meridian.
    """
    radius, width = c[0], c[1]
    number = (len(c) - 2) // 3
    which = min(max(math.floor(X / width + 0.5 * number), 0), number - 1)
    longitude = (X - (which + 0.5 - 0.5 * number) * width) / radius
    latitude = Y / radius
    at = 2 + 3 * which
    return (
        c[at] + radius * math.cos(latitude) * math.sin(longitude),
        c[at + 1] + radius * math.sin(latitude),
        c[at + 2] + radius * math.cos(latitude) * math.cos(longitude),
    )


@compiled
def _smooth_point(kind, c, position, X, Y):
    if kind == REFERENCE_PLANE:  # origin, direction of X, direction of Y; no load moves it
        return c[0] + c[3] * X + c[6] * Y, c[1] + c[4] * X + c[7] * Y, c[2] + c[5] * X + c[8] * Y
    if kind == RIGID:
        return _rigid_point(c, position, X, Y)
    if kind == PLATE:
        return _plate_point(c, position, X, Y)
    if kind == SKIN:
        return _skin_point(c, position, X, Y)
    if kind == CYLINDER:
        return _cylinder_point(c, position, X, Y)
    if kind == SPHERES:
        return _spheres_point(c, X, Y)
    return _leather_point(c, position, X, Y)


@compiled
def _into_sensor(pose, x, y, z):
    """Return a vector of the specimen's frame in that of the sensor, without the translation."""
    return (
        pose[0] * x + pose[1] * y + pose[2] * z,
        pose[3] * x + pose[4] * y + pose[5] * z,
        pose[6] * x + pose[7] * y + pose[8] * z,
    )


@compiled
def surface_point(surface, X, Y):
    """Return the position x, y, z [m] of the material point (X, Y)."""
    x, y, z = _smooth_point(surface.kind, surface.coefficients, surface.position, X, Y)
    z += stroke_sum(surface, X, Y)[0]
    if surface.placed:
        x, y, z = _into_sensor(surface.pose, x, y, z)
        x, y, z = x + surface.pose[9], y + surface.pose[10], z + surface.pose[11]
    return x, y, z


@compiled
def surface_tangents(surface, X, Y):
    """Return the derivatives of the position along X (three values) and along Y (three values)."""
    kind, c, position = surface.kind, surface.coefficients, surface.position
    ax, ay, az = _smooth_point(kind, c, position, X + HALF_STEP, Y)
    bx, by, bz = _smooth_point(kind, c, position, X - HALF_STEP, Y)
    ex, ey, ez = _smooth_point(kind, c, position, X, Y + HALF_STEP)
    fx, fy, fz = _smooth_point(kind, c, position, X, Y - HALF_STEP)
    slope_x, slope_y = stroke_sum(surface, X, Y)[1:]
    k = 0.5 / HALF_STEP
    ax, ay, az = (ax - bx) * k, (ay - by) * k, (az - bz) * k + slope_x
    ex, ey, ez = (ex - fx) * k, (ey - fy) * k, (ez - fz) * k + slope_y
    if surface.placed:
        ax, ay, az = _into_sensor(surface.pose, ax, ay, az)
        ex, ey, ez = _into_sensor(surface.pose, ex, ey, ez)
    return ax, ay, az, ex, ey, ez


@in_parallel
def surface_points(surface, X, Y, x, y, z):
    """Fill in the positions x, y, z of all material points of a map (NaN in, NaN out)."""
    for i in prange(X.shape[0]):
        for j in range(X.shape[1]):
            if math.isnan(X[i, j]):
                x[i, j] = y[i, j] = z[i, j] = np.nan
            else:
                x[i, j], y[i, j], z[i, j] = surface_point(surface, X[i, j], Y[i, j])


# Pin-holes -----------------------------------------------------------------------------------------------------------
# A pin-hole is a vector: position (3), rotation row-major (9; columns right, up, backwards), scale along columns and
# rows [px], principal column and row, lens (k1, k2, p1, p2, k3; bump: shift along columns and rows, centre, radius, in
# pixels).
# The camera and the projector are the same kind of thing.


@compiled
def _into_frame(p, x, y, z):
    return (
        p[3] * x + p[6] * y + p[9] * z,
        p[4] * x + p[7] * y + p[10] * z,
        p[5] * x + p[8] * y + p[11] * z,
    )


@compiled
def _through_lens(p, m, n):
    """Return column and row of the direction (m right, n up), and their derivatives by m and by n.

    Brown's lens in OpenCV's terms, whose y is -n, then a shift that falls off as a Gaussian around a place of the
    image.
    """
    y = -n
    square = m * m + y * y
    radial = 1.0 + square * (p[16] + square * (p[17] + square * p[20]))
    growth = (
        2.0 * p[16] + 4.0 * p[17] * square + 6.0 * p[20] * square * square
    )  # radial changes by growth * (m dm + y dy)
    column = p[14] + p[12] * (m * radial + 2.0 * p[18] * m * y + p[19] * (square + 2.0 * m * m))
    row = p[15] + p[13] * (y * radial + p[18] * (square + 2.0 * y * y) + 2.0 * p[19] * m * y)
    column_m = p[12] * (radial + m * m * growth + 2.0 * p[18] * y + 6.0 * p[19] * m)
    column_y = p[12] * (m * y * growth + 2.0 * p[18] * m + 2.0 * p[19] * y)
    row_m = p[13] * (m * y * growth + 2.0 * p[18] * m + 2.0 * p[19] * y)
    row_y = p[13] * (radial + y * y * growth + 6.0 * p[18] * y + 2.0 * p[19] * m)
    if p[21] != 0.0 or p[22] != 0.0:
        dc, dr = (column - p[23]) / p[25], (row - p[24]) / p[25]
        bump = math.exp(-0.5 * (dc * dc + dr * dr))
        fall_m = -bump * (dc * column_m + dr * row_m) / p[25]
        fall_y = -bump * (dc * column_y + dr * row_y) / p[25]
        column, row = column + p[21] * bump, row + p[22] * bump
        column_m, column_y = column_m + p[21] * fall_m, column_y + p[21] * fall_y
        row_m, row_y = row_m + p[22] * fall_m, row_y + p[22] * fall_y
    return column, row, column_m, -column_y, row_m, -row_y


@compiled
def project(p, x, y, z):
    """Return column and row at which a pin-hole sees (or lights) a point."""
    qx, qy, qz = _into_frame(p, x - p[0], y - p[1], z - p[2])
    column, row, _, _, _, _ = _through_lens(p, -qx / qz, -qy / qz)
    return column, row


@compiled
def _project_tangent(p, x, y, z, tx, ty, tz):
    """Return the change of column and row when a pin-hole's point (x, y, z) moves along (tx, ty, tz)."""
    qx, qy, qz = _into_frame(p, x - p[0], y - p[1], z - p[2])
    dx, dy, dz = _into_frame(p, tx, ty, tz)
    dm, dn = (qx * dz / qz - dx) / qz, (qy * dz / qz - dy) / qz
    _, _, column_m, column_n, row_m, row_n = _through_lens(p, -qx / qz, -qy / qz)
    return column_m * dm + column_n * dn, row_m * dm + row_n * dn


@in_parallel
def straight_pixels(p, column, row):
    """Fill in where a pin-hole without its lens would see what it sees at each pixel, by Newton's iteration."""
    for i in prange(column.shape[0]):
        for j in range(column.shape[1]):
            m, n = (j - p[14]) / p[12], (p[15] - i) / p[13]
            for _ in range(50):
                seen_c, seen_r, cm, cn, rm, rn = _through_lens(p, m, n)
                dc, dr = j - seen_c, i - seen_r
                determinant = cm * rn - cn * rm
                m += (dc * rn - dr * cn) / determinant
                n += (dr * cm - dc * rm) / determinant
                if abs(dc) + abs(dr) < CONVERGED:
                    break
            column[i, j] = p[14] + p[12] * m
            row[i, j] = p[15] - p[13] * n


@in_parallel
def project_points(p, x, y, z, column, row):
    """Fill in columns and rows of all points of a map."""
    for i in prange(x.shape[0]):
        for j in range(x.shape[1]):
            column[i, j], row[i, j] = project(p, x[i, j], y[i, j], z[i, j])


@compiled
def _on_plane(camera, column, row):
    """Return where the camera ray of a pixel meets z = 0: the start of the search."""
    m = (column - camera[14]) / camera[12]
    n = (camera[15] - row) / camera[13]
    x = camera[3] * m + camera[4] * n - camera[5]
    y = camera[6] * m + camera[7] * n - camera[8]
    z = camera[9] * m + camera[10] * n - camera[11]
    return camera[0] - camera[2] / z * x, camera[1] - camera[2] / z * y


@in_parallel
def solve_pixels(camera, surface, X, Y, residual):
    """Fill in the material point (X, Y) that every pixel sees.

    Damped Newton iteration along each row from pixel to pixel; it extrapolates the start and keeps the Jacobian while
    the iteration converges. ``residual`` [px] is the distance between the pixel and the projection of the point found.
    """
    for i in prange(X.shape[0]):
        base_x, base_y = _on_plane(camera, 0.0, float(i))
        step_x = step_y = 0.0
        inverse_xc = inverse_xr = inverse_yc = inverse_yr = 0.0
        for j in range(X.shape[1]):
            start_x, start_y = base_x, base_y
            base_x += step_x
            base_y += step_y
            base_c = base_r = move_x = move_y = 0.0
            fraction = 1.0
            best = np.inf
            here = False  # whether the Jacobian belongs to the base point
            for _ in range(80):
                x, y, z = surface_point(surface, base_x + fraction * move_x, base_y + fraction * move_y)
                column, row = project(camera, x, y, z)
                error_c = column - j
                error_r = row - i
                error = math.sqrt(error_c * error_c + error_r * error_r)
                if error < best:
                    base_x += fraction * move_x
                    base_y += fraction * move_y
                    base_c, base_r = error_c, error_r
                    slow = error > 0.02 * best
                    here = False
                    best = error
                    if best < CONVERGED:
                        break
                elif here:
                    fraction *= 0.5
                    continue
                else:
                    slow = True
                if slow or inverse_xc == 0.0:
                    x, y, z = surface_point(surface, base_x, base_y)
                    ax, ay, az, bx, by, bz = surface_tangents(surface, base_x, base_y)
                    ca, ra = _project_tangent(camera, x, y, z, ax, ay, az)
                    cb, rb = _project_tangent(camera, x, y, z, bx, by, bz)
                    determinant = ca * rb - cb * ra
                    inverse_xc, inverse_xr = rb / determinant, -cb / determinant
                    inverse_yc, inverse_yr = -ra / determinant, ca / determinant
                    here = True
                move_x = -inverse_xc * base_c - inverse_xr * base_r
                move_y = -inverse_yc * base_c - inverse_yr * base_r
                fraction = 1.0
            if j == 0:
                step_x, step_y = inverse_xc, inverse_yc
            else:
                step_x, step_y = base_x - start_x, base_y - start_y
            X[i, j] = base_x
            Y[i, j] = base_y
            residual[i, j] = best


@in_parallel
def solve_from_starts(camera, surface, X, Y, residual):
    """Replace material points near those that the pixels see by these, as `solve_pixels` (NaN in, NaN out).

    Every pixel has its own start, because a sensor in any pose may see several sides of a specimen in one row.
    """
    for i in prange(X.shape[0]):
        for j in range(X.shape[1]):
            base_x, base_y = X[i, j], Y[i, j]
            best = np.inf
            if math.isnan(base_x):
                residual[i, j] = best
                continue
            try_x, try_y = base_x, base_y
            move_x = move_y = 0.0
            for _ in range(60):
                x, y, z = surface_point(surface, try_x, try_y)
                column, row = project(camera, x, y, z)
                error_c, error_r = column - j, row - i
                error = math.sqrt(error_c * error_c + error_r * error_r)
                if error < best:
                    base_x, base_y, best = try_x, try_y, error
                    if best < CONVERGED:
                        break
                    ax, ay, az, bx, by, bz = surface_tangents(surface, base_x, base_y)
                    ca, ra = _project_tangent(camera, x, y, z, ax, ay, az)
                    cb, rb = _project_tangent(camera, x, y, z, bx, by, bz)
                    determinant = ca * rb - cb * ra
                    move_x = (cb * error_r - rb * error_c) / determinant
                    move_y = (ra * error_c - ca * error_r) / determinant
                else:
                    move_x, move_y = 0.5 * move_x, 0.5 * move_y
                try_x, try_y = base_x + move_x, base_y + move_y
            X[i, j], Y[i, j], residual[i, j] = base_x, base_y, best


@in_parallel
def light_geometry(camera, projector, surface, X, Y, maps):
    """Fill in projector coordinates, irradiance and camera-facing cosine of every solved pixel (NaN stays NaN).

    The irradiance is Lambert's cosine times the distance fall-off, 1 on a plane z = 0 at the origin; zero or less means
    that the surface faces away from the projector.
    """
    column, row, irradiance, facing = maps
    px, py, pz = projector[0], projector[1], projector[2]
    reference = math.sqrt(px * px + py * py + pz * pz)
    for i in prange(X.shape[0]):
        for j in range(X.shape[1]):
            if math.isnan(X[i, j]):
                column[i, j] = row[i, j] = irradiance[i, j] = facing[i, j] = np.nan
                continue
            x, y, z = surface_point(surface, X[i, j], Y[i, j])
            ax, ay, az, bx, by, bz = surface_tangents(surface, X[i, j], Y[i, j])
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            norm = math.sqrt(nx * nx + ny * ny + nz * nz)
            lx, ly, lz = px - x, py - y, pz - z
            distance = math.sqrt(lx * lx + ly * ly + lz * lz)
            relative = reference / distance
            cosine = (nx * lx + ny * ly + nz * lz) / (norm * distance)
            irradiance[i, j] = cosine * relative * relative * reference / pz
            vx, vy, vz = camera[0] - x, camera[1] - y, camera[2] - z
            facing[i, j] = (nx * vx + ny * vy + nz * vz) / (norm * math.sqrt(vx * vx + vy * vy + vz * vz))
            column[i, j], row[i, j] = project(projector, x, y, z)


@compiled
def _material_below(surface, x, y, X, Y):
    """Return the material point at the plan position (x, y), searched from (X, Y), and its height z."""
    for _ in range(20):
        px, py, z = surface_point(surface, X, Y)
        ex, ey = px - x, py - y
        if abs(ex) + abs(ey) < 1e-9:
            break
        ax, ay, _az, bx, by, _bz = surface_tangents(surface, X, Y)
        determinant = ax * by - bx * ay
        X += (bx * ey - by * ex) / determinant
        Y += (ay * ex - ax * ey) / determinant
    return X, Y, z


@in_parallel
def cast_shadows(projector, surface, search, X, Y, suspected, lit):
    """Mark suspected points as not lit where the specimen stands between them and the projector.

    The light path is followed from the surface towards the projector in steps in plan until it is above the highest
    point of the specimen; at each step the surface below is solved exactly.
    """
    outline, top, stride = search
    for i in prange(X.shape[0]):
        for j in range(X.shape[1]):
            if not suspected[i, j]:
                continue
            material_x, material_y = X[i, j], Y[i, j]
            x, y, z = surface_point(surface, material_x, material_y)
            lx, ly, lz = projector[0] - x, projector[1] - y, projector[2] - z
            plan = math.sqrt(lx * lx + ly * ly)
            steps = math.ceil((top - z) / lz * plan / stride)
            for k in range(1, steps + 1):
                t = k * stride / plan
                material_x, material_y, height = _material_below(
                    surface, x + t * lx, y + t * ly, material_x, material_y
                )
                on_specimen = outline[0] <= material_x <= outline[1] and outline[2] <= material_y <= outline[3]
                if on_specimen and height > z + t * lz:
                    lit[i, j] = False
                    break


@in_parallel
def reflectance(texture, floor, X, Y, value):
    """Fill in the reflectance of the painted surface, floor + (1 - floor) exp(-sum of optical densities)."""
    for i in prange(X.shape[0]):
        for j in range(X.shape[1]):
            if math.isnan(X[i, j]):
                value[i, j] = 0.0
            else:
                value[i, j] = floor + (1.0 - floor) * math.exp(-stroke_sum(texture, X[i, j], Y[i, j])[0])


@compiled
def _bars(position, pitch, blur):
    """Return bars half of the pitch wide, centred on 0, seen through a Gaussian blur: 0 dark, 1 white."""
    nearest = position - pitch * math.floor(position / pitch + 0.5)
    white = 1.0
    k = math.sqrt(0.5) / blur
    for bar in range(-2, 3):
        from_left, from_right = nearest - (bar - 0.25) * pitch, nearest - (bar + 0.25) * pitch
        white -= 0.5 * (math.erf(from_left * k) - math.erf(from_right * k))
    return white


@in_parallel
def printed_grid(white, ink, pitch, turn, blur, X, Y, value):
    """Fill in the reflectance of a grid printed on the plane.

    Crossed bars of half the pitch, or with ``blur`` 0 crossed cosines.

    ``turn`` [rad] is counter-clockwise as the camera sees it; ``ink`` is the reflectance of the print.
    """
    c, s = math.cos(turn), math.sin(turn)
    for i in prange(X.shape[0]):
        for j in range(X.shape[1]):
            if math.isnan(X[i, j]):
                value[i, j] = 0.0
                continue
            a, b = c * X[i, j] + s * Y[i, j], c * Y[i, j] - s * X[i, j]
            if blur > 0.0:
                bright = _bars(a, pitch, blur) * _bars(b, pitch, blur)
            else:
                k = 2.0 * math.pi / pitch
                bright = 0.25 * (1.0 - math.cos(k * a)) * (1.0 - math.cos(k * b))
            value[i, j] = ink + (white - ink) * bright
