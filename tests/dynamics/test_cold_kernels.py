"""Compiled kernels give the same bits in the first run on a machine and in later ones."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
import hashlib
import numpy as np
import robustlab as rl

plant = rl.plant("stewart-platform", preset="physical")
rest = rl.trim(plant)
x = rest.x + 1e-2 * np.random.default_rng(0).normal(size=(20, 12))
found = plant.local_models(x, np.tile(rest.u, (20, 1)))
print(hashlib.sha256(b"".join(part.tobytes() for part in (found.A, found.B, found.rates))).hexdigest())
"""


@pytest.mark.slow
def test_compiled_now_or_read_from_disk(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    outputs = [
        subprocess.run([sys.executable, "-c", SCRIPT], env=environment, check=True, capture_output=True).stdout
        for _ in range(2)
    ]
    assert outputs[0] == outputs[1]
