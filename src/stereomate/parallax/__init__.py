"""Artificial parallax of a stereomate: laws, their choice, residual parallaxes and homogeneity."""
