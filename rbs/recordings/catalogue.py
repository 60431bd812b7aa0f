"""The scenes in data/, in groups, with a line each for --help and the window's list."""

SCENES = {
    "falling": {
        "singletet": "one tetrahedron",
        "singlebox": "one box",
        "single_cylinder": "one cylinder",
        "two_cylinder": "two cylinders and a constraint",
        "tet": "25 tetrahedra",
    },
    "many shapes": {
        "mixed": "seven shapes in a tray",
        "tower": "a tower that collapses",
        "stress": "many shapes among fixed posts",
    },
    "constraints": {
        "cube": "eight bodies, each linked to every other",
        "tower_chain": "a tower of linked bodies",
        "two_chain": "two chains",
        "bridge": "a rope bridge, and bodies that fall onto it",
        "net": "a net of 400 bodies that catches three others",
        "chimes": "224 pendulums and a chain of 20 links, with the queue",
        "wrecking_ball": "a ball on a chain that hits a stack",
    },
    "friction": {
        "incline": "boxes on slopes: one slides, one stays",
        "slide": "boxes sliding to a stop",
        "roll": "a cylinder, a ball and an ellipsoid that roll",
        "settle": "spinning boxes that come to rest",
    },
    "standing": {
        "stack": "a stack of 20 boxes",
        "pyramid": "a pyramid of 120 boxes",
        "arch": "an arch of 15 wedges",
        "dome": "a dome of 44 blocks",
        "round_tower": "a round tower of 67 blocks",
        "card_house": "a house of 15 cards",
        "ramp": "boxes on slopes of 26° and 28°; friction holds one",
    },
    "falling over": {
        "dominoes": "ten dominoes; the first one falls",
        "wall": "a brick wall and a wrecking ball",
        "arch_blow": "an arch hit by a ball",
        "cradle": "Newton's cradle",
    },
    "heaps and loads": {
        "heap": "a dense heap of 1000 bodies",
        "pile_200": "a pile of 200 bodies",
        "pile_1000": "a pile of 1000 bodies",
        "loaded_bridge": "a rope bridge under load",
        "loaded_net": "a net under load",
    },
}
