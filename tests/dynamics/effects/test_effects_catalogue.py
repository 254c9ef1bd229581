"""Properties of every effect of the catalogue."""

from dataclasses import fields

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import Footprint, Scales, Simulator, Windows, catalogue, effect, port_model
from robustlab.errors import InputError

IDS = list(catalogue())
PLANTS = ["dc-motor", "servo-axis", "two-mass", "mass-spring-damper", "linear-actuator"]
AT_JOINT = {"force_unit": "N m", "speed_unit": "rad/s", "position_unit": "rad"}
SCALES = {
    "joint": Scales(force=0.02, speed=50.0, position=20.0, inertia=1e-5, **AT_JOINT),
    "current": Scales(force=12.0, speed=3.0, current=3.0, force_unit="V", speed_unit="A"),
    "input": Scales(input=12.0, signal_unit="V"),
    "output": Scales(output=10.0, signal_unit="rad"),
    "parameter": Scales(),
}


@pytest.mark.parametrize("plant_name", PLANTS)
@pytest.mark.parametrize("name", IDS)
def test_it_runs_at_each_of_its_sites(name, plant_name):
    known, plant = effect(name), rl.plant(plant_name)
    model = port_model(plant)
    u = np.random.default_rng(2).normal(size=(60, len(plant.inputs)))
    for site in known.sites(plant, model):
        where = Scales()
        if site.kind in ("joint", "current"):
            port = model.ports[site.name]
            assert port.kind == site.kind
            inertia = 1.0 / float(port.velocity @ port.force)
            where = Scales(inertia=inertia, **AT_JOINT)
        values = known.starts(where)[0]
        simulator = Simulator(plant, [(known, site)], u, 1e-3)
        windows = Windows(np.array([0, 30]), 30)
        motion = simulator.run({}, [values], np.zeros((2, len(plant.states))), windows)
        assert np.isfinite(motion.outputs).all()
        footprint = known.footprint(site, values, 0.7)
        if footprint is not None:
            assert isinstance(footprint, Footprint)
            assert footprint.gain_lower <= footprint.gain_upper
            known_numbers = [f.name for f in fields(footprint) if f.type == "float" and f.name != "describing"]
            assert all(np.isfinite(getattr(footprint, field)) for field in known_numbers)
            # NaN: no describing function; else it is within the sector.
            gain = footprint.describing
            assert np.isnan(gain) or footprint.gain_lower <= gain <= footprint.gain_upper


@pytest.mark.parametrize("name", IDS)
def test_missing_and_unknown_values_are_named(name):
    known = effect(name)
    values = known.starts(SCALES[known.site_kind])[0]
    with pytest.raises(InputError, match=known.id):
        known.checked({**values, "no_such": 1.0})
    with pytest.raises(InputError, match="no value for"):
        known.checked({})
