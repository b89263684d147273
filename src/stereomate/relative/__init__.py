"""Relative orientation of a pair: over-correction, empirical and rigorous solutions, drawings as values."""
