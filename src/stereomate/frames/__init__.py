"""Geocentric, tangent and map frames, height systems, map scale, curvature, attitudes. Only place that
imports pyproj."""
