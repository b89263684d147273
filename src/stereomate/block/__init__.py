"""Blocks of photographs: tie points, start values, adjustment and its statistics."""
