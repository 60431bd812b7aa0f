"""Pixels: pictures made smaller, and laid over each other. uint8, (height, width, 3 or 4).

The fourth channel is the opacity. Polyscope has no part in this.
"""

import numpy as np


def averaged(picture, factor):
    """Each factor x factor pixels as one; (height, width, 3 or 4), uint8."""
    height, width, channels = picture.shape
    blocks = picture.reshape(height // factor, factor, width // factor, factor, channels)
    if channels == 3:
        total = blocks.sum(axis=(1, 3), dtype=np.uint16)
        return ((total + factor**2 // 2) // factor**2).astype(np.uint8)
    # What is not there at all has no colour to give.
    opacity = blocks[..., 3:].astype(np.float32)
    weight = opacity.sum(axis=(1, 3))
    colour = (blocks[..., :3] * opacity).sum(axis=(1, 3)) / np.maximum(weight, 1.0)
    return np.rint(np.concatenate([colour, weight / factor**2], axis=2)).astype(np.uint8)


def laid_over(upper, lower):
    """A picture with opacity over one with or without it, as many channels as the lower one."""
    above = upper[..., 3:].astype(np.float32) / 255.0
    if lower.shape[2] == 3:
        return np.rint(above * upper[..., :3] + (1.0 - above) * lower).astype(np.uint8)
    below = (1.0 - above) * (lower[..., 3:] / np.float32(255.0))
    colour = above * upper[..., :3] + below * lower[..., :3]
    colour /= np.maximum(above + below, 1e-6)
    return np.rint(np.concatenate([colour, 255.0 * (above + below)], axis=2)).astype(np.uint8)
