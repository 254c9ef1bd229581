"""Monitoring of a machine: detects when its model stops explaining a running log, and identifies the change.

change_test    the sequential test, and its rate of false alarms
watch          `watch`: a log in pieces from beginning to end, and its result
"""

from robustlab.identification.monitoring.change_test import ChangeTest, PieceEquations, onset

__all__ = ["ChangeTest", "PieceEquations", "onset"]
