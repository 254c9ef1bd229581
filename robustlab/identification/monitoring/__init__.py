"""Watching a machine: does its model go on explaining a running log, and what changes where it does not.

change_test    the sequential test, and its rate of false alarms
piece          one piece of a log as equations in these
watch          `watch`: a log in pieces from beginning to end
watch_result   its result
"""
