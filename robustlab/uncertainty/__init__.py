"""Uncertain models: blocks, linear fractional transformations, the thesis' element-wise uncertainty."""
