"""Mesh files as other programs write them, made from facts of the formats, and their bodies.

python tests/scenes/foreignFiles.py FOLDER      writes them
"""

import base64
import json
import re
import struct
import sys
from pathlib import Path

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


def soup(text):
    """An OFF file whose faces have vertices of their own."""
    lines = text.splitlines()
    faces = [line.split()[1:] for line in lines[10:]]
    places, rows = [], []
    for face in faces:
        rows.append(f"{len(face)} " + " ".join(str(len(places) + k) for k in range(len(face))))
        places += [lines[2 + int(corner)] for corner in face]
    return "\n".join([f"OFF {len(places)} {len(faces)} 0", *places, *rows])


def halves(shift):
    """An OBJ file of two boxes that touch: halves of the cube, or beside each other along z."""
    lines = []
    for k in range(2):
        for x, y, z in CORNERS:
            lines.append(f"v\t{0.5 * (int(x) + k)}\t{y}\t{float(z) + shift * k} 0.5 0.5 0.5")
        lines += [
            "f " + " ".join(str(int(i) + 8 * k + 1) for i in square) for _, *square in SQUARES
        ]
    return "\n".join(lines)


def stl(trailing):
    """The cube in binary, with a header that looks like text, and bytes behind."""
    places = [[float(x) for x in corner] for corner in CORNERS]
    corners = [
        (places[int(s[0])], places[int(s[k])], places[int(s[k + 1])])
        for _, *s in SQUARES
        for k in (1, 2)
    ]
    rows = [struct.pack("<12fH", 0, 0, 0, *sum(one, start=[]), 0) for one in corners]
    return b"solid cube".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows) + trailing


def stl_text(separator):
    """The cube as text, with a name in another encoding."""
    words = ["solid W\xfcrfel"]
    for _, *square in SQUARES:
        for k in (1, 2):
            rows = [" ".join(["vertex", *CORNERS[int(square[j])]]) for j in (0, k, k + 1)]
            words += ["facet normal 0 0 0", "outer loop", *rows, "endloop", "endfacet"]
    return separator.join([*words, "endsolid"]).encode("latin-1")


def gltf(uri):
    """Half the cube's size in a node that doubles it, and has a child that moves it."""
    places = [0.5 * float(x) for corner in CORNERS for x in corner]
    corners = [int(s[j]) for _, *s in SQUARES for k in (1, 2) for j in (0, k, k + 1)]
    content = struct.pack("<24f36H", *places, *corners)
    uri = uri or "data:application/octet-stream;base64," + base64.b64encode(content).decode()
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
    ]
    accessors[0] |= {"min": [0, 0, 0], "max": [0.5, 0.5, 0.5]}
    views = [{"byteOffset": 0, "byteLength": 96}, {"byteOffset": 96, "byteLength": 72}]
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"scale": [2, 2, 2], "children": [1]}, {"mesh": 0, "translation": [3, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0} | view for view in views],
        "buffers": [{"byteLength": len(content), "uri": uri}],
    }
    return json.dumps(document)


def obj(heading, corner, first):
    """The cube in blocks, each a square with four vertices of its own."""
    lines = []
    for k, (_, *square) in enumerate(SQUARES):
        rows = [" ".join(["v", *CORNERS[int(i)]]) for i in square]
        face = " ".join(corner.format(first + (4 * k + i if first > 0 else i)) for i in range(4))
        lines += [heading.format(k), *rows, "vt 0 0", "vn 0 0 1", f"f {face}"]
    return "\n".join(lines)


def ply(order, colour=b"", hasTexture=False):
    """The mixed cube in binary, with colours (3 bytes) or none."""
    table = [line.split() for line in MIXED.splitlines()]
    corners, faces = table[2:11], table[11:]
    lines = ["ply", f"format binary_{'big' if order == '>' else 'little'}_endian 1.0"]
    lines += ["element vertex 9", *(f"property float {axis}" for axis in "xyz")]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")[: len(colour)]]
    lines += ["element face 7", "property list uchar int vertex_indices"]
    lines += ["property list uchar float texcoord"] * hasTexture
    rows = [struct.pack(f"{order}3f", *map(float, corner)) + colour for corner in corners]
    for n, *face in faces:
        rows.append(struct.pack(f"{order}B{n}i", int(n), *map(int, face)))
        rows.append(
            struct.pack(f"{order}B{2 * int(n)}f", 2 * int(n), *[0.5] * 2 * int(n)) * hasTexture
        )
    return "\n".join([*lines, "end_header\n"]).encode() + b"".join(rows)


def ply_text():
    """The cube, with normals, of which some are none, and flags of faces."""
    lines = ["ply", "format ascii 1.0", "comment from 3.0 to 4", "element vertex 8"]
    lines += [f"property float {name}" for name in ("nx", "x", "y", "z")]
    lines += ["element face 6", "property uchar flags", "property list uint8 int32 vertex_index"]
    lines += ["element edge 1", "property int a", "end_header"]
    lines += ["nan " + " ".join(corner).replace("0", "0.0", 1) for corner in CORNERS]
    return "\n".join([*lines, *("7 " + " ".join(square) for square in SQUARES), "3"])


# Sections that have no meaning here.
OTHERS = """Edges\n1\n1 2 7\nCorners 2\n1\n2\nRidges 0\nNormals 1 0 0 -1
Quadrilaterals 1 1 2 3 4 0\nIdentifier "Vertices # 1 and the End of it"\nRequiredVertices\n1 1
Prisms 0\n"""
# By what each file has, how it is written. The body is the tetrahedron or the cube, of volume 1.
MEDIT = {
    "nothing special": t(),
    "lower case": t().lower(),
    "upper case": t().upper(),
    "one line": " ".join(t().split()),
    "a number a line": "\n".join(t().split()),
    "counts beside keywords": re.sub(r"([a-z])\n(\d)", r"\1 \2", t()),
    "numbers below keywords": t(("Formatted 1", "Formatted\n2"), ("sion 3", "sion\n3")),
    "tabs, CR-LF and a byte-order mark": "\ufeff" + t().replace(" ", "\t").replace("\n", "\r\n"),
    "exponents with D": t(("1.5", "15.0D-01"), ("0 2 0 1", "0d0 +2.D+00 -0 -1.5")),
    "comments": t(("0 2 0 1", "0 2 # and z\n0 1"), ("2\n1 2 3", "2 # of them\n\n1 2 3")),
    "the dimension first": t((HEADER, "Dimension 3\nMeshVersionFormatted\n2\n")),
    "Latin-1": t(("Vert", '# ü\nIdentifier "Würfel"\nVert')).encode("latin-1"),
    "text after End": t() + "1 2 3 Vertices",
    "no End": t(("End\n", "")),
    "vertices last": HEADER + TETS + TRIANGLES + VERTICES,
    "other sections": t(("End", OTHERS + "End")),
    "other sections first": t(("Vertices", f"{OTHERS}Vertices")),
    "both orientations": t(("1 3 2 1", "2 3 1 1"), ("1 2 3 5", "2 1 3 5")),
    "no triangles": HEADER + VERTICES + TETS,
    "an empty section": HEADER + VERTICES + "Triangles 0\n" + TETS,
    "a triangle left out": t(("6\n1 3 2 1\n", "5\n")),
    "a triangle twice": t(("6\n1 3 2 1\n", "7\n1 3 2 1\n1 3 2 1\n")),
    "an inner triangle": t(("6\n1 3", "7\n2 3 5 1\n1 3")),
    "coarser triangles": HEADER + VERTICES + "Triangles 4 1 3 2 1 1 2 4 1 1 4 3 1 2 3 4 1\n" + TETS,
    "an unused vertex": t(("s\n5", "s\n6"), ("0 0 1.5 1", "0 0 1.5 1\n9 9 9 1")),
    "a vertex twice": t(
        ("s\n5", "s\n6"), ("0 0 1.5 1", "0 0 1.5 1\n1 0 0 1"), ("5 2 3 4", "5 6 3 4")
    ),
}
OFF = {
    "nothing special": off("OFF"),
    "no keyword": off("OFF")[4:],
    "one line": " ".join(CUBE.split()),
    "a number a line": "\n".join(CUBE.split()),
    "several entries a line, and normals": off("NOFF", " 0 0 1").replace("\n0", " 0"),
    "lower case": off("off"),
    "both cases": off("cOff", " 255 0 0 255"),
    "vertices of each face": soup(CUBE),
    "counts beside the keyword": off("OFF").replace("OFF\n", "OFF "),
    "no number of edges": changed(CUBE, ("8 6 12", "8 6\n")),
    "comments": changed(CUBE, ("OFF", "# a cube\nOFF # text"), ("0 0 0", "0 0 0 # here")),
    "normals": off("NOFF", " 0 0 1"),
    "colours in bytes": off("COFF", " 255 0 0 255"),
    "colours in floats": off("COFF", " 1.0 .5 0 1"),
    "colours and normals": off("CNOFF", " 255 0 0 255 0 0 1"),
    "normals and colours": off("NCOFF", " 0 0 1 255 0 0 255"),
    "texture": off("STOFF", " 0.5 0.5"),
    "texture, colours and normals": off("STCNOFF", " 0 0 1 0 0 1 0 0 1"),
    "columns without a prefix": off("OFF", " 128 128 128"),
    "colours of faces": changed(
        CUBE, ("2 1 0\n", "2 1 0 255 0 0\n"), ("5 6 7", "5 6 7 .1 .2 .3 1")
    ),
    "rows over several lines": changed(CUBE, ("0 1 1\n", "0\n1 1\n"), ("4 4 5 6 7", "4\n4 5\n6 7")),
    "edges and points": changed(CUBE, ("8 6", "8 8"), ("4 3 2 1 0", "2 0 1\n1 7\n4 3 2 1 0")),
    "triangles, squares and pentagons": MIXED,
    "an unused vertex": changed(CUBE, ("8 6", "9 6"), ("0 1 1\n", "0 1 1\n-9 9 9\n")),
    "both orientations": changed(CUBE, ("3 2 1 0", "0 1 2 3"), ("4 1 2 6 5", "4 5 6 2 1")),
}
OBJ = {
    "blocks": obj("o side{}", "{}", 1),
    "blocks of materials": obj("usemtl red{}", "{0}/1/1", 1),
    "blocks counted backwards": obj("g side{}", "{}", -4),
    "blocks with normals counted backwards": obj("o side{}", "{0}//-1", -4),
    "lines that go on": obj("  # side {}", "\\\n{0}/-1", -4).replace("f ", "  f "),
    "a mark and Latin-1": b"\xef\xbb\xbf" + obj("o Würfel {}", "{}", 1).encode("latin-1"),
    "halves that touch": halves(0),
    "comments behind": obj("o side{}", "{}", 1).replace("\nvt", " # corner\nvt") + " # last",
}
PLY = {
    "text": ply_text(),
    "little end first": ply("<"),
    "colours": ply("<", b"abc"),
    "texture": ply(">", hasTexture=True),
}
STL = {"binary": stl(b""), "bytes behind": stl(b"junk"), "text": stl_text("\n")}
STL |= {"text in one line": stl_text(" "), "capitals": stl_text("\r\n").upper()}
GLTF = {"a file of its own": gltf("")}
FILES = {"mesh": MEDIT, "off": OFF, "obj": OBJ, "ply": PLY, "stl": STL, "gltf": GLTF}
# Vertices, faces and tetrahedra. The fan from the corner before the middle of an edge has a flat
# triangle, without a tetrahedron.
COUNTS = dict.fromkeys(FILES, (9, 12, 12)) | {"mesh": (5, 6, 2), "ply": (10, 14, 13)}
COUNTS |= {"text.ply": COUNTS["off"]}
COUNTS |= {"vertices of each face.off": (25, 12, 12), "halves that touch.obj": (13, 24, 20)}
COUNTS |= {"an unused vertex.mesh": (6, 6, 2), "a vertex twice.mesh": (6, 8, 2)}
COUNTS |= {
    "an unused vertex.off": (10, 12, 12),
    "triangles, squares and pentagons.off": (10, 14, 13),
}


def cases():
    """Yields (name of the file, its content as bytes, (vertices, faces, tetrahedra))."""
    for ending, contents in FILES.items():
        for trait, content in contents.items():
            name = f"{trait}.{ending}"
            content = content if isinstance(content, bytes) else content.encode()
            yield name, content, COUNTS.get(name, COUNTS[ending])


if __name__ == "__main__":
    for name, content, _ in cases():
        Path(sys.argv[1], name).write_bytes(content)
