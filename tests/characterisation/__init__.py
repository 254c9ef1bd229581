"""Answers of an earlier revision, so that a change of the code that changes an answer is seen: see the test module."""
