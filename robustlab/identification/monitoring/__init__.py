"""Watching a machine: does its model go on explaining a running log, and what changes where it does not.

change_test    the sequential test, and its rate of false alarms
watch          `watch`: a log in pieces from beginning to end, and its result
"""

from robustlab.identification.monitoring.change_test import ChangeTest, PieceEquations, onset

__all__ = ["ChangeTest", "PieceEquations", "onset"]
