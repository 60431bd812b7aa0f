"""Drawings of a shape as SVG, for notebooks: no window, no OpenGL."""

import numpy as np

from rbs.geometry.surfaces import area_vectors

# Directions from the shape to the eye, to the right of it and above it, and to the light.
EYE, LIGHT = np.array([0.45, 0.36, 1.0]), np.array([-0.4, 0.8, 0.45])
# RGB of a surface that faces the light, 0 to 255, and the fraction of it in the dark.
COLOUR, DARK = np.array([86.0, 180.0, 233.0]), 0.35
# Width and height in pixels, and the free margin as a fraction of it.
SIZE, MARGIN = 160, 0.06


def draw_shape(vertices, faces):
    """Returns the SVG of a closed surface in parallel projection, or "" without faces.

    vertices : (V, 3); faces : (F, 3), counter-clockwise seen from outside. Those that look towards
        the eye are drawn from the farthest to the nearest
    """
    if len(faces) == 0:
        return ""
    backward = EYE / np.linalg.norm(EYE)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    across = area_vectors(vertices, faces)
    lengths = np.linalg.norm(across, axis=1, keepdims=True)
    normals = across / np.maximum(lengths, np.finfo(float).tiny)
    seen = np.flatnonzero(normals @ backward > 1e-9)
    seen = seen[np.argsort(vertices[faces[seen]].mean(axis=1) @ backward, kind="stable")]
    places = vertices @ np.stack([right, -np.cross(backward, right)], axis=1)  # y points down
    low, high = places.min(axis=0), places.max(axis=0)
    scale = (1.0 - 2.0 * MARGIN) * SIZE / max(np.max(high - low), np.finfo(float).tiny)
    places = (places - (low + high) / 2.0) * scale + SIZE / 2.0
    light = np.maximum(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0.0)
    polygons = []
    for face in seen.tolist():
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in places[faces[face]])
        r, g, b = np.rint(COLOUR * (DARK + (1.0 - DARK) * light[face])).astype(int)
        # a stroke of its own colour closes the seams between neighbours
        paint = f'fill="#{r:02x}{g:02x}{b:02x}" stroke="#{r:02x}{g:02x}{b:02x}"'
        polygons.append(f'<polygon points="{corners}" {paint} stroke-width="0.5"/>')
    view = f'viewBox="0 0 {SIZE} {SIZE}" width="{SIZE}" height="{SIZE}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {view}>{"".join(polygons)}</svg>'
