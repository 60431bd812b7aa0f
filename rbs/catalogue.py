"""What our scenes show, in groups with a line each: for the window's list and for --help."""

SCENES = {
    "falling": {
        "singletet": "one tetrahedron",
        "singlebox": "one box",
        "single_cylinder": "one cylinder",
        "two_cylinder": "two cylinders and a constraint",
        "tet": "25 tetrahedra",
    },
    "piling up": {
        "mixed": "seven shapes on the ground",
        "tower": "a tower that falls apart",
        "stress": "many shapes between fixed posts",
        "pile_200": "a pile of 200 bodies",
        "pile_1000": "a pile of 1000 bodies",
    },
    "constraints": {
        "cube": "eight bodies, constraints between every two",
        "tower_chain": "a tower whose bodies hang together",
        "two_chain": "two chains",
        "bridge": "a rope bridge, and what falls onto it",
        "net": "a net of 400 bodies that catches three",
        "wrecking_ball": "a ball on a chain hits a stack",
    },
    "friction": {
        "incline": "a slope with friction",
        "slide": "boxes that slide to a stop",
        "roll": "bodies that roll",
        "settle": "bodies that settle",
    },
    "resting, with --solver soft-step --friction 0.5 --restitution 0": {
        "stack": "20 boxes on each other",
        "pyramid": "a pyramid of 120 boxes",
        "dominoes": "ten dominoes, the first one pushed",
    },
}
