"""The units that the tests of this folder share, built once."""

from __future__ import annotations

from functools import cache

import fmu_units as units
import pytest

import robustlab as rl


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fmu")


@pytest.fixture(scope="session")
def plant_of(unit):
    """The plant of such a unit; parameters are changed with ``with_parameters``, so that one process serves all."""

    @cache
    def made(version=2, **options):
        return rl.plant(unit(version, **options))

    return made


@pytest.fixture(scope="session")
def unit(folder):
    """The file of a unit of a version of FMI, with options of `fmu_units.description`."""

    def made(version=2, **options):
        name = "-".join([f"unit{version}", *(f"{k}{v:d}" for k, v in options.items())])
        path = folder / f"{name}.fmu"
        if not path.exists():
            units.packed(path, units.description(version, **options), units.library(version, folder), version)
        return str(path)

    return made
