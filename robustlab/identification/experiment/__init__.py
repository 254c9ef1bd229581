"""Design of the next experiment: the one that separates the named effects from their rivals best."""

from robustlab.identification.experiment.next_experiment import NextExperiment, propose_experiment

__all__ = ["NextExperiment", "propose_experiment"]
