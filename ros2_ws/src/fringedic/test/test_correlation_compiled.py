"""What is compiled: everything at set-up, and the same numbers from any number of threads."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from fringedic.correlation import kernels, measure_displacement, node_kernels
from fringedic.warm_up import warm_up

MEASURE = """
import hashlib, numpy as np
from fringedic import measure_displacement
texture = np.random.default_rng(5).integers(0, 4096, (150, 211)).astype(np.float32)
texture = (texture + np.roll(texture, 1, 0) + np.roll(texture, 1, 1) + np.roll(texture, (1, 1), (0, 1))) / 4
moved = np.roll(texture, (1, 2), (0, 1))
moved[60:80, 90:120] = np.nan
digest = hashlib.sha256()
for spacing in (1, 3):
    field = measure_displacement(texture, moved, window=24, spacing=spacing)
    for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y", "valid"):
        digest.update(field[name].to_numpy().tobytes())
print(digest.hexdigest())
"""


def test_any_number_of_threads_gives_the_same_bits():
    digests = {
        threads: subprocess.run(
            [sys.executable, "-c", MEASURE],
            env={**os.environ, "NUMBA_NUM_THREADS": threads, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2", "3")
    }
    assert len(digests["1"].strip()) == hashlib.sha256().digest_size * 2
    assert len(set(digests.values())) == 1


@pytest.mark.slow
def test_warm_up_leaves_nothing_to_compile(capsys):
    warm_up()
    assert "displacement of white uint16 images" in capsys.readouterr().out
    compiled = {
        name: kernel
        for module in (kernels, node_kernels)
        for name, kernel in vars(module).items()
        if hasattr(kernel, "signatures")
    }
    before = {name: len(kernel.signatures) for name, kernel in compiled.items()}
    texture = np.random.default_rng(5).integers(0, 255, (100, 120)).astype(np.uint8)
    for dtype in (np.uint8, np.uint16, np.float32):
        f, g = texture.astype(dtype), np.roll(texture, 1, axis=0).astype(dtype)
        start = measure_displacement(f, g, mask=np.tri(100, 120, 30, dtype=bool))
        measure_displacement(f, g, initial=start)
        measure_displacement(f, g, spacing=4, window=16)
    assert {name: len(kernel.signatures) for name, kernel in compiled.items()} == before
