"""Kernels of the bundle adjustment: arrays in, arrays out.

- `projection`: one observation with its derivatives;
- `structure`: order of observations and photographs;
- `normal`: normal equations with the points eliminated, and the points afterwards;
- `covariance`: everything that needs a part of the inverse.
"""
