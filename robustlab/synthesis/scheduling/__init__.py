"""Gain scheduling: LPV models, their induced gain, controllers scheduled by measured parameters."""
