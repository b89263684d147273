"""The golden scene: an analytic surface in a Cartesian frame, seen by two tilted cameras, as a surface to
measure in."""

from __future__ import annotations

import numpy as np

from stereomate.parallax.laws import ParallaxLaw


class AnalyticSurface:
    """Sum of Gaussians over a level; axes u, v turned against east and north; points are (E, N, Z)."""

    def __init__(self, scene: dict, wrong: bool = False) -> None:
        self.terrain, self.wrong = scene["terrain"], wrong
        turn = np.radians(scene["product_grid"]["rows_direction_deg_from_east_ccw"])
        # (u, v) -> (E - E0, N - N0)
        self.turn = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self.origin = np.array([self.terrain["E0"], self.terrain["N0"]])

    def map(self, uv):
        return uv @ self.turn.T + self.origin

    def uv(self, en):
        return (np.asarray(en) - self.origin) @ self.turn

    def of_map(self, en):
        """(Z, dZ/dE, dZ/dN)."""
        east, north = (en - self.origin).T
        z, ze, zn = np.full(east.shape, self.terrain["Z_ref_m"]), np.zeros(east.shape), np.zeros(east.shape)
        for hill in self.terrain["gaussians"]:
            turn = np.radians(hill["az_deg_from_east_ccw"])
            c, s = np.cos(turn), np.sin(turn)
            x, y = east - hill["cE_m"], north - hill["cN_m"]
            a, b = c * x + s * y, -s * x + c * y
            part = hill["A_m"] * np.exp(-0.5 * ((a / hill["s_a_m"]) ** 2 + (b / hill["s_b_m"]) ** 2))
            by_a, by_b = -part * a / hill["s_a_m"] ** 2, -part * b / hill["s_b_m"] ** 2
            z, ze, zn = z + part, ze + c * by_a - s * by_b, zn + s * by_a + c * by_b
        if self.wrong:
            tilt, to = np.tan(np.radians(2.0)), np.radians(50.0)
            z = z + 10.0 + tilt * (east * np.cos(to) + north * np.sin(to))
            ze, zn = ze + tilt * np.cos(to), zn + tilt * np.sin(to)
        return np.stack([z, ze, zn], axis=-1)

    # what a measuring surface must offer

    def heights(self, uv):
        out = self.of_map(self.map(uv))
        out[:, 1:] = out[:, 1:] @ self.turn
        return out

    def shown(self, law: ParallaxLaw, uv):
        """The largest root along the row on a 0.5 m scan, then bisection."""
        at = uv[:, :1] + np.arange(-180.0, 260.0, 0.5)
        places = np.stack([at, np.broadcast_to(uv[:, 1:], at.shape)], axis=-1)
        heights = self.of_map(self.map(places.reshape(-1, 2)))[:, 0].reshape(at.shape)
        below = at - law.q(heights) - uv[:, :1] < 0.0
        crossing = below[:, :-1] & ~below[:, 1:]
        last = crossing.shape[1] - 1 - np.argmax(crossing[:, ::-1], axis=1)
        start = np.take_along_axis(at, last[:, None], axis=1)[:, 0]
        changes = (below[:, :-1] != below[:, 1:]).sum(axis=1)
        return np.where(crossing.any(axis=1), start + 0.25, np.nan), changes

    def points(self, uvh):
        axes = np.zeros((len(uvh), 3, 3))
        axes[:, :2, :2], axes[:, 2, 2] = self.turn, 1.0
        return np.column_stack([self.map(uvh[:, :2]), uvh[:, 2]]), axes


def law_of(scene: dict, kind: str) -> ParallaxLaw:
    law = scene["law"]
    return ParallaxLaw(kind, law["base_m"], law["w0_m"], law["reference_level_Z_m"])


def centres_of(scene: dict, count: int):
    return tuple(np.tile(np.array(scene["cameras"][side]["X_m"]), (count, 1)) for side in ("left", "right"))
