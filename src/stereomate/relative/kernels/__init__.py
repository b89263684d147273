"""Numeric kernels of relative orientation."""
