"""The plants under models/plants, as tests take them."""

import runpy
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "models" / "plants"
NAMES = ("cart_pole", "two_link_arm", "water_tank", "quadrotor_height")


@cache
def maker(name):
    """The function of the same name in the file ``name``."""
    return runpy.run_path(str(FOLDER / f"{name}.py"))[name]
