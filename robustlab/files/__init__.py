"""Files from outside: untrusted HDF5, MATLAB and text files into plain arrays, and atomic writing.

This room knows nothing of models; `robustlab.storage` maps trees to objects.
"""
