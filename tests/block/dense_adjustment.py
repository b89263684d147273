"""A second bundle adjustment for the tests: dense, by central differences, with a whole inverse."""

from __future__ import annotations

import numpy as np

from stereomate.block.unknowns import camera_from_values, camera_values
from stereomate.geometry.rotations import rotation_from_vector


class Dense:
    """Unknowns: photographs (6 each), points (3 each), free interior parameters, in this order."""

    def __init__(self, network):
        self.network = network
        self.entry = network.cameras[0]
        labels = (*self.entry.camera.parameter_names, "pixel_aspect", "pixel_shear")
        self.chosen = [i for i, label in enumerate(labels) if label in self.entry.free]
        self.prior = np.array([self.entry.free[labels[i]] for i in self.chosen])
        self.n, self.p = len(network.photographs.names), len(network.points.names)
        self.size = 6 * self.n + 3 * self.p + len(self.chosen)

    def computed(self, step, centres, rotations, points, values):
        """Computed observations after a step: image, control, positions, priors."""
        net = self.network
        photos = step[: 6 * self.n].reshape(-1, 6)
        c, r = centres + photos[:, :3], rotation_from_vector(photos[:, 3:]) @ rotations
        x = points + step[6 * self.n : 6 * self.n + 3 * self.p].reshape(-1, 3)
        v = values.copy()
        v[self.chosen] += step[6 * self.n + 3 * self.p :]
        camera = camera_from_values(self.entry.camera, v)
        local = np.einsum("mji,mj->mi", r[net.image.photo], x[net.image.point] - c[net.image.photo])
        parts = [camera.image_from_camera(local)[0].ravel()]
        if net.control is not None:
            parts.append(x[net.control.point].ravel())
        if net.positions is not None:
            arm = np.einsum("gij,gj->gi", r[net.positions.photo], net.positions.lever_arm)
            parts.append((c[net.positions.photo] + arm).ravel())
        parts.append(v[self.chosen][np.isfinite(self.prior)])
        return np.concatenate(parts)

    def observed(self):
        net = self.network
        parts, sigma = [net.image.xy.ravel()], [net.image.sigma.ravel()]
        for part in (net.control, net.positions):
            if part is not None:
                parts.append(part.xyz.ravel())
                sigma.append(part.sigma.ravel())
        finite = np.isfinite(self.prior)
        parts.append(camera_values(self.entry.camera)[self.chosen][finite])
        sigma.append(self.prior[finite])
        return np.concatenate(parts), np.concatenate(sigma)

    def at(self, centres, rotations, points, values):
        """Residuals, standard deviations and design matrix (central differences) at a state."""
        observed, sigma = self.observed()
        state = (centres, rotations, points, values)
        residual = observed - self.computed(np.zeros(self.size), *state)
        design = np.empty((len(observed), self.size))
        for i in range(self.size):
            h = 1e-4 if i < 6 * self.n + 3 * self.p and not (i < 6 * self.n and i % 6 >= 3) else 1e-6
            step = np.zeros(self.size)
            step[i] = h
            design[:, i] = (self.computed(step, *state) - self.computed(-step, *state)) / (2 * h)
        return residual, sigma, design
