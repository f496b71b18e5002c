"""Random orientations, and rotation of vectors by quaternions, on the host."""

import numpy as np


def random_orientations(count: int, random: np.random.Generator) -> np.ndarray:
    """Return uniformly distributed random unit quaternions x, y, z, w, shape (count, 4)."""
    q = random.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def rotate(quaternions: np.ndarray, vectors: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Rotate `vectors` (n, 3) by unit quaternions x, y, z, w of shape (n, 4); with `inverse`, rotate them back."""
    axis, w = quaternions[:, :3], quaternions[:, 3:]
    if inverse:
        axis = -axis
    twice = 2 * np.cross(axis, vectors)
    return vectors + w * twice + np.cross(axis, twice)
