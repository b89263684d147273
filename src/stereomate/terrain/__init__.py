"""Height models: sampling, voids, break-lines, cross-sections and ray intersection."""
