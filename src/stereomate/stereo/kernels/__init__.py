"""Numeric kernels of exact measuring and of the homogeneity raster."""
