"""Mesh files as other programs write them, made from facts of the formats, and their bodies."""

import numpy as np

# A right-angled tetrahedron with legs 1, 2, 3 (volume 1), of two tetrahedra: vertex 5 halves the
# leg of 3. Its faces look outward.
HEADER = "MeshVersionFormatted 1\nDimension 3\n"
VERTICES = "Vertices\n5\n0 0 0 1\n1 0 0 1\n0 2 0 1\n0 0 3 1\n0 0 1.5 1\n"
TRIANGLES = "Triangles\n6\n1 3 2 1\n1 2 5 1\n5 2 4 1\n1 5 3 1\n5 4 3 1\n2 3 4 1\n"
TETS = "Tetrahedra\n2\n1 2 3 5 1\n5 2 3 4 1\n"
TETRAHEDRON = HEADER + VERTICES + TRIANGLES + TETS + "End\n"
# The unit cube of six squares.
CUBE = "OFF\n8 6 12\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n"
CUBE += "4 3 2 1 0\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n"
CORNERS, SQUARES = ([line.split() for line in CUBE.splitlines()[k:][:8]] for k in (2, 10))


def changed(text, *pairs):
    """A text in which the first `old` of each pair (old, new) is replaced by `new`."""
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def t(*pairs):
    return changed(TETRAHEDRON, *pairs)


# The cube with two triangles above, and below an edge with a corner in its middle.
MIXED = changed(
    CUBE, ("8 6", "9 7"), ("4 4 5 6 7", "3 4 5 6\n3 4 6 7"), ("0 1 1\n", "0 1 1\n.5 0 0\n")
)
MIXED = changed(MIXED, ("4 3 2 1 0", "5 3 2 1 8 0"), ("4 0 1 5", "5 0 8 1 5"))


def off(header, more=""):
    """The cube with another keyword and more columns behind each vertex."""
    lines = changed(CUBE, ("OFF", header)).splitlines()
    return "\n".join([*lines[:2], *(line + more for line in lines[2:10]), *lines[10:]])


def soup():
    """The cube as an OFF file whose faces have vertices of their own."""
    places = [" ".join(CORNERS[int(corner)]) for _, *square in SQUARES for corner in square]
    rows = ["4 " + " ".join(str(4 * k + i) for i in range(4)) for k in range(6)]
    return "\n".join(["OFF 24 6 0", *places, *rows])


def halves():
    """The halves of the cube, boxes that touch, as an OBJ file with tabs and colours."""
    lines = []
    for k in range(2):
        lines += [f"v\t{0.5 * (int(x) + k)}\t{y}\t{z} 0.5 0.5 0.5" for x, y, z in CORNERS]
        faces = [[str(int(i) + 8 * k + 1) for i in square] for _, *square in SQUARES]
        lines += ["f " + " ".join(face) for face in faces]
    return "\n".join(lines)


def obj(heading, corner, first):
    """The cube in blocks, each a square with four vertices of its own."""
    lines = []
    for k, (_, *square) in enumerate(SQUARES):
        rows = [" ".join(["v", *CORNERS[int(i)]]) for i in square]
        face = " ".join(corner.format(first + (4 * k + i if first > 0 else i)) for i in range(4))
        lines += [heading.format(k), *rows, "vt 0 0", "vn 0 0 1", f"f {face}"]
    return "\n".join(lines)


PLY_36 = "ply\nformat ascii 1.0\nelement vertex 36\nproperty double x\nproperty double y\n"
PLY_36 += "property double z\nelement face 12\nproperty list uchar int vertex_indices\nend_header"


def soup_text(ending, wrong, form="{!r}"):
    """A turned prism of volume 1 whose faces have corners of their own, which differ by `wrong`."""
    turn, points = np.array([[0.8, 0.36, 0.48], [-0.6, 0.48, 0.64], [0.0, -0.8, 0.6]]), []
    for _, *square in SQUARES:
        places = np.array([CORNERS[int(i)] for i in square], dtype=float) @ turn
        points += [*places[:3], places[0], *places[2:]]
    points += wrong * np.random.default_rng(5).uniform(-1, 1, (36, 3))
    if ending == "STL":
        table = np.zeros(12, dtype=[("normal", "<3f4"), ("places", "<9f4"), ("flags", "<u2")])
        table["places"] = points.reshape(-1, 9)
        return b" " * 80 + np.uint32(12).tobytes() + table.tobytes()
    rows = [" ".join(form.format(float(x)) for x in point) for point in points]
    first = range(0, 36, 3)
    if ending == "obj":
        lines = [f"v {row}" for row in rows] + [f"f {k + 1} {k + 2} {k + 3}" for k in first]
    elif ending == "stl":
        facet = "facet normal 0 0 0\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet"
        lines = ["solid a", *(facet.format(*rows[k : k + 3]) for k in first), "endsolid a"]
    else:
        heading = "OFF 36 12 0" if ending == "off" else PLY_36
        lines = [heading, *rows, *(f"3 {k} {k + 1} {k + 2} 255" for k in first), ""]
    return "\n".join(lines)


# Sections that have no meaning here.
OTHERS = """Edges\n1\n1 2 7\nCorners 2\n1\n2\nRidges 0\nNormals 1 0 0 -1
Quadrilaterals 1 1 2 3 4 0\nIdentifier "Vertices # 1 and the End of it"\nRequiredVertices\n1 1
Prisms 0\n"""
# By what each file has, how it is written. The body is the tetrahedron or the cube, of volume 1.
MEDIT = {
    "nothing special": t(),
    "tabs, CR-LF and a byte-order mark": "\ufeff" + t().replace(" ", "\t").replace("\n", "\r\n"),
    "exponents with D": t(("1.5", "15.0D-01"), ("0 2 0 1", "0d0 +2.D+00 -0 -1.5")),
    "comments": t(("0 2 0 1", "0 2 # and z\n0 1"), ("2\n1 2 3", "2 # of them\n\n1 2 3")),
    "Latin-1": t(("Vert", '# ü\nIdentifier "Würfel"\nVert')).encode("latin-1"),
    "no End": t(("End\n", "")),
    "other sections first": t(("Vertices", f"{OTHERS}Vertices")),
    "both orientations": t(("1 3 2 1", "2 3 1 1"), ("1 2 3 5", "2 1 3 5")),
    "no triangles": HEADER + VERTICES + TETS,
    "coarser triangles": HEADER + VERTICES + "Triangles 4 1 3 2 1 1 2 4 1 1 4 3 1 2 3 4 1\n" + TETS,
    "an unused vertex": t(("s\n5", "s\n6"), ("0 0 1.5 1", "0 0 1.5 1\n9 9 9 1")),
    "a vertex twice": t(
        ("s\n5", "s\n6"), ("0 0 1.5 1", "0 0 1.5 1\n1 0 0 1"), ("5 2 3 4", "5 6 3 4")
    ),
}
OFF = {
    "nothing special": off("OFF"),
    "no keyword": off("OFF")[4:],
    "vertices of each face": soup(),
    "comments": changed(CUBE, ("OFF", "# a cube\nOFF # text"), ("0 0 0", "0 0 0 # here")),
    "texture, colours and normals": off("STCNOff", " 0 0 1 0 0 1 0 0 1"),
    "edges and points": changed(CUBE, ("8 6", "8 8"), ("4 3 2 1 0", "2 0 1\n1 7\n4 3 2 1 0")),
    "three kinds of faces": MIXED,
    "an unused vertex": changed(CUBE, ("8 6", "9 6"), ("0 1 1\n", "0 1 1\n-9 9 9\n")),
    "both orientations": changed(CUBE, ("3 2 1 0", "0 1 2 3"), ("4 1 2 6 5", "4 5 6 2 1")),
}
OBJ = {
    "blocks": obj("o side{}", "{}", 1),
    "lines that go on": obj("  # side {}", "\\\n{0}/-1", -4).replace("f ", "  f "),
    "a mark and Latin-1": b"\xef\xbb\xbf" + obj("o Würfel {}", "{}", 1).encode("latin-1"),
    "halves that touch": halves(),
    "comments behind": obj("o side{}", "{}", 1).replace("\nvt", " # corner\nvt") + " # last",
}
FILES = {"mesh": MEDIT, "off": OFF, "obj": OBJ}
# Vertices, faces and tetrahedra. The fan from the corner before the middle of an edge has a flat
# triangle, without a tetrahedron.
COUNTS = {"mesh": (5, 6, 2), "off": (9, 12, 12), "obj": (9, 12, 12)}
COUNTS |= {"vertices of each face.off": (25, 12, 12), "halves that touch.obj": (13, 24, 20)}
COUNTS |= {"an unused vertex.mesh": (6, 6, 2), "a vertex twice.mesh": (6, 8, 2)}
COUNTS |= {"an unused vertex.off": (10, 12, 12), "three kinds of faces.off": (10, 14, 13)}


def cases():
    """Yields (name of the file, its content as bytes, (vertices, faces, tetrahedra))."""
    for ending, contents in FILES.items():
        for trait, content in contents.items():
            name = f"{trait}.{ending}"
            content = content if isinstance(content, bytes) else content.encode()
            yield name, content, COUNTS.get(name, COUNTS[ending])
