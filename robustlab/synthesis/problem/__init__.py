"""Shared parts of every design: partition, assumptions, scaling, the rebuilt loop and its certificate."""
