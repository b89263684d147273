"""Interior orientation: cameras, distortion, fiducial transforms."""
