"""Static output feedback on COMPleib plants against HIFOO 3.501 and the best static norm that is known."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.norms import hinf_norm
from robustlab.statespace import StateSpaceModel, lower_lft

COMPLEIB = Path(__file__).parents[3] / "shared" / "data" / "compleib.h5"


@pytest.mark.shared
@pytest.mark.skipif(not COMPLEIB.exists(), reason="measured data not beside the checkout")
@pytest.mark.parametrize("name", ["NN15", "AC17", "AC5"])
def test_static_output_feedback_reaches_the_best_known(name):
    with h5py.File(COMPLEIB) as file:
        m = {key: file[name][key][()] for key in file[name]}
        best, hifoo = (float(file[name].attrs[k]) for k in ("static_hinf_best", "static_hinf_hifoo3501_measured"))
    n_y, n_u = m["C"].shape[0], m["B"].shape[1]
    D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((n_y, n_u))]])
    P = StateSpaceModel(m["A"], np.hstack([m["B1"], m["B"]]), np.vstack([m["C1"], m["C"]]), D)
    design = rl.fixed_structure(P, "static", n_meas=n_y, n_con=n_u, starts=2)
    norm = hinf_norm(lower_lft(P, design.K))
    assert norm.upper == pytest.approx(design.gamma, rel=1e-9)
    assert norm.upper <= 1.001 * min(best, hifoo)
