"""Monitoring of a machine: detects when its model stops explaining a running log, and identifies the change."""

from robustlab.identification.monitoring.watch import ChangeTest, PieceEquations, onset

__all__ = ["ChangeTest", "PieceEquations", "onset"]
