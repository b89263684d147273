"""Model codes and the layout of the parameter array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
Six = tuple[float, float, float, float, float, float]

PINHOLE, BROWN, BROWN_INVERSE, OPENCV, FISHEYE = 0, 1, 2, 3, 4
# Brown's models followed by what film does: deformation and a projective scan.
FILM, FILM_INVERSE = 5, 6

COLUMNS, ROWS = 0, 1
P = 2  # 2..7 pixel (of film: film coordinates) from measured, row by row
P_INV = 8
E = 14
E_INV = 20
R2_MAX = 26  # squared radius of the argument of D up to which D is monotonic
R_START = 27  # finite upper end of the bracket of the radial inversion
R0, K1, K2, K3, K4 = 28, 29, 30, 31, 32  # R = R0 + K1 r² + ...
P1, P2, B1, B2 = 33, 34, 35, 36
D1, D2, D3 = 37, 38, 39  # denominator 1 + D1 r² + ...
S1, S2, S3, S4 = 40, 41, 42, 43
T = 44  # 3x3 homography of the tilted sensor
T_INV = 53
F = 62  # 62..73 Ebner's twelve, in units of the spacing of his grid
A = 74  # 74..79 numerators of the pixel from the deformed film coordinates
Q = 80  # 80..81 denominator 1 + Q0 x + Q1 y
F_R2_MAX = 82  # squared radius of the film coordinates up to which the deformation is monotonic
HALF = 83  # 83..84 half the width and height of the picture, film coordinates
LENGTH = 85
