"""Kernels of the synthetic world: exact ray tracing and procedural colour."""
