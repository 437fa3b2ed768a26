"""The meaning of files: records, cameras, Gaussians, fields, npz, PLY and zarr, the description of a dataset.

Everything else builds on it; it builds on numpy and the standard library.
"""
