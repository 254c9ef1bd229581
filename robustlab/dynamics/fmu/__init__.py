"""Functional mock-up units (FMI 2.0 and 3.0) in the place of a plant: programs of others, run in a child process only.

description       what a unit says of itself: its archive and modelDescription.xml, read as untrusted bytes
frames            messages between the two processes
unit_process      the parent's end: starts the child, waits with a time limit, ends it
worker            the child's end: ``python -m robustlab.dynamics.fmu.worker``
native_unit       the functions of the unit's library, FMI 2.0 and 3.0 alike, through FMPy
exchange_runs     model exchange: rates and derivatives at points, integration with events
co_simulation_runs   co-simulation: steps, and derivatives where the unit has them
fmu_plant         `FmuPlant`, a model-exchange unit as a nonlinear plant
fmu_co_simulation `FmuCoSimulation`, a co-simulation unit as a plant that steps itself
"""

from __future__ import annotations

from robustlab.dynamics.fmu.fmu_co_simulation import FmuCoSimulation
from robustlab.dynamics.fmu.fmu_plant import FmuPlant, fmu

__all__ = ["FmuCoSimulation", "FmuPlant", "fmu"]
