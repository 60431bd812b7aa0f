"""Arrows and lines, in Polyscope: what overlays are drawn with.

Polyscope is imported inside the functions that use it.
"""

# Half the widths of arrows, points and lines, relative to the scene's size.
ARROW_RADIUS = 3e-3
POINT_RADIUS = 4e-3
LINE_RADIUS = 8e-4


def remove_overlay(name):
    """Removes what `draw_arrows` or `draw_lines` has drawn under this name, if anything."""
    import polyscope as ps

    ps.remove_point_cloud(name, error_if_absent=False)
    ps.remove_curve_network(name, error_if_absent=False)


def draw_arrows(name, points, arrows, colour, radius=ARROW_RADIUS):
    """Points (m, 3) with arrows (m, 3) in metres, in place of the last ones of this name."""
    import polyscope as ps

    ps.remove_point_cloud(name, error_if_absent=False)
    if len(points):
        cloud = ps.register_point_cloud(
            name, points, color=colour, radius=POINT_RADIUS, material="flat"
        )
        cloud.add_vector_quantity(
            "arrows",
            arrows,
            vectortype="ambient",
            radius=radius,
            color=colour,
            material="flat",
            enabled=True,
        )


def draw_lines(name, nodes, edges, colour, radius=LINE_RADIUS):
    """Lines between nodes (n, 3), edges (m, 2), in place of the last ones of this name."""
    import polyscope as ps

    ps.remove_curve_network(name, error_if_absent=False)
    if len(edges):
        ps.register_curve_network(name, nodes, edges, radius=radius, color=colour, material="flat")
