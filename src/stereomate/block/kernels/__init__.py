"""Kernels of the bundle adjustment: arrays in, arrays out.

- `projection`: one observation with its derivatives;
- `structure`: order of observations and photographs;
- `small`: 3x3 blocks, and the motion that a photograph gives to a point;
- `normal`, `elimination`: normal equations, each point taken out as soon as it is complete;
- `points`: the points afterwards;
- `blocks`: parts of a matrix in band or dense form;
- `system`: observations of single photographs, photographs moved;
- `covariance`: everything that needs a part of the inverse;
- `alternatives`: which observations of a point explain a contradiction.
"""
