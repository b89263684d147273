"""Rotations, rigid transforms, collinearity, intersection, resection, similarity."""
