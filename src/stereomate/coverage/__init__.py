"""What the photographs of a survey cover: footprints, overlap, pairs, base/height and pixel size."""
