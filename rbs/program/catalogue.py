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
        "mixed": "seven shapes in a tray",
        "tower": "a tower that falls apart",
        "stress": "many shapes between fixed posts",
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
    "standing": {
        "stack": "20 boxes on each other",
        "pyramid": "a pyramid of 120 boxes",
        "arch": "an arch of 15 wedges",
        "dome": "a dome of 44 blocks",
        "round_tower": "a round tower of 67 blocks",
        "card_house": "a house of 15 cards",
        "ramp": "a box that friction holds, and one that it does not",
    },
    "falling over": {
        "dominoes": "ten dominoes, the first one falls",
        "wall": "a wall, and a wrecking ball",
        "arch_blow": "an arch that a ball hits",
        "cradle": "Newton's cradle",
    },
    "heaps and loads": {
        "heap": "a dense heap of 1000 bodies",
        "pile_200": "a pile of 200 bodies",
        "pile_1000": "a pile of 1000 bodies",
        "loaded_bridge": "a rope bridge, and what it carries",
        "loaded_net": "a net, and what it carries",
    },
}
