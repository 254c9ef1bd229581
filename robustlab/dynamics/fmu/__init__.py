"""Functional mock-up units (FMI 2.0 and 3.0) in the place of a plant: programs of others, run in a child process only.

description       what a unit says of itself: its archive and modelDescription.xml, read as untrusted bytes
unit_process      the parent's end: starts the child, waits with a time limit, ends it; messages between the two
worker            the child's end: ``python -m robustlab.dynamics.fmu.worker``
native_unit       the functions of the unit's library, FMI 2.0 and 3.0 alike, through FMPy
unit_runs         model exchange: rates, derivatives, integration with events; co-simulation: steps, derivatives
fmu_plant         `FmuPlant`, a model-exchange unit as a nonlinear plant; `FmuCoSimulation`, one that steps itself
"""

from __future__ import annotations

from robustlab.dynamics.fmu.fmu_plant import FmuCoSimulation, FmuPlant, fmu

__all__ = ["FmuCoSimulation", "FmuPlant", "fmu"]
