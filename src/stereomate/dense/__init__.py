"""Dense matching of image pairs whose parallaxes lie along the rows, and surfaces from it."""
