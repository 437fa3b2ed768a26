"""The renderer's kernels for CPUs, compiled by numba: 16 pixels are one value, one block of the picture.

`gof.render.backend.kernels` says whether they run. Imported only then: numba is an optional part.
"""
