"""Compiled kernels: all compiled at set-up, and the same bits from any number of threads."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest

from fringedic.correlation import cell_kernels, image_kernels, measure_displacement, node_kernels, resampling_kernels
from fringedic.frames import interpolation_kernels
from fringedic.warm_up.pipeline import warm_up

MEASURE = """
import hashlib, numba, numpy as np
from fringedic.correlation import measure_displacement
texture = np.random.default_rng(5).integers(0, 4096, (150, 211)).astype(np.float32)
texture = (texture + np.roll(texture, 1, 0) + np.roll(texture, 1, 1) + np.roll(texture, (1, 1), (0, 1))) / 4
moved = np.roll(texture, (1, 2), (0, 1))
moved[60:80, 90:120] = np.nan
for threads in (1, 2, 3):
    numba.set_num_threads(threads)
    digest = hashlib.sha256()
    for spacing in (1, 3):
        field = measure_displacement(texture, moved, window=24, spacing=spacing)
        for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y", "valid"):
            digest.update(field[name].to_numpy().tobytes())
    print(digest.hexdigest())
"""

KERNELS = {
    name: kernel
    for module in (image_kernels, interpolation_kernels, resampling_kernels, cell_kernels, node_kernels)
    for name, kernel in vars(module).items()
    if hasattr(kernel, "signatures")
}


def test_results_do_not_depend_on_the_order_of_compilation():
    """Numba compiles a function that states no `fastmath` with that of the first caller: all callers have to agree."""
    inherited = defaultdict(set)
    for kernel in KERNELS.values():
        for name in kernel.py_func.__code__.co_names:
            called = kernel.py_func.__globals__.get(name)
            if hasattr(called, "signatures") and "fastmath" not in called.targetoptions:
                inherited[name].add(str(kernel.targetoptions.get("fastmath")))
    assert len(inherited) > 5
    assert [name for name, options in inherited.items() if len(options) > 1] == []


def test_any_number_of_threads_gives_the_same_bits():
    process = subprocess.run(
        [sys.executable, "-c", MEASURE],
        env={**os.environ, "NUMBA_NUM_THREADS": "3", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    one, two, three = process.stdout.split()
    assert len(one) == hashlib.sha256().digest_size * 2
    assert one == two == three


@pytest.mark.slow
def test_warm_up_leaves_nothing_to_compile(capsys):
    warm_up()
    assert "whole pipeline" in capsys.readouterr().out
    before = {name: len(kernel.signatures) for name, kernel in KERNELS.items()}
    texture = np.random.default_rng(5).integers(0, 255, (100, 120)).astype(np.uint8)
    for dtype in (np.uint8, np.uint16, np.float32):
        f, g = texture.astype(dtype), np.roll(texture, 1, axis=0).astype(dtype)
        start = measure_displacement(f, g, mask=np.tri(100, 120, 30, dtype=bool))
        measure_displacement(f, g, initial=start)
        measure_displacement(f, g, spacing=4, window=16)
    assert {name: len(kernel.signatures) for name, kernel in KERNELS.items()} == before
