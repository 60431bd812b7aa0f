"""The rooms behind the four modules of the coursework: one purpose each.

A newcomer starts at `run_timestep` in RBSFunctions.py. Data flows one way: files → meshes → steps →
pictures and recordings. Rooms import only what stands above them in this list, and nothing imports
`graders`, `tests` or `report`.

Algebra and geometry, below GJK.py
    arrays        indexing of long arrays in few calls
    triples       vectors of three floats
    vectors       the same for arrays of vectors
    hulls         convex hulls, of one shape and of many bodies
    facets        the facets of the Minkowski difference that can be nearest
    patches       contact points; polygons and their overlaps, for manifolds too

What a step may be asked
    messages      errors and lines for the terminal
    settings      the table of settings; their values for a scene; what is refused

Below RBSFunctions.py, which has the coursework's formulas for a body or a pair
    bodies        the state of meshes in tables, and what is checked of it
    reports       what a step tells of itself

Many bodies at once, to which RBSFunctions.py hands the meshes over
    kernels       its formulas for contacts and constraints, on arrays
    broadphase    boxes that overlap, through uniform grids
    batches       contacts in ordered batches, and what a pass may have missed
    gridstep      the step of `broadPhase="grid"`
    constraints   the constraints that can be corrected, and which one is visited when

The solver in which piles rest, behind `contactSolver="soft-step"`
    springs           soft bounds as impulses, and what another time step does to them
    manifolds         up to four contact points a pair
    sleeping          who sleeps, and who wakes
    contactdetection  which manifolds are kept, and which are made anew
    softcontacts      contacts, all manifolds at once, with their derivation; restitution
    softconstraints   distance constraints, renewed every substep
    softstep          the step, and what it leaves to the next

Scenes, above RBSFunctions.py
    files         reading with a limit, writing whole files
    textfiles     text files, line by line
    meshfiles     .mesh and .off
    scenelines    lines of scene and constraint files, taken apart
    state         a scene in some state: energies, momenta
    scenes        scene and constraint files
    catalogue     what our scenes show
    changes       what is done to bodies by hand, and how it is recorded
    grabbing      the spring that a body is dragged by, and the ball that is shot
    simulation    a scene, its settings, and its steps
    submissions   modules of someone else in place of ours
    submittedsteps  steps of a scene by a student's functions

Recordings
    recording     writing and reading the HDF5 file
    replay        replaying, resuming, verifying
    statistics    the numbers of every step, as a table or a plot

What is seen; Polyscope is imported in cameras, arrows, drawing, facenumbers, studio, and all from
pictures on but pictureprocess, playback and layout
    pictureoptions  what the command line may ask of a picture
    colours, drawables, backends, cameras, arrows, drawing
    skins         how the surfaces of bodies meet the light
    facenumbers   which face is seen, from the camera and from the light
    light         sky, sun, and what bodies and ground send to each other
    studio        pictures with that light
    pictures      pictures and videos, in either look
    pictureprocess  a studio picture that another process draws
    gltf          export of a run to 3-D programs
    playback      how many steps a frame makes
    layout        where the panels lie
    widgets, plots, helppanel, panel
    viewer        what buttons and keys do, and the window itself

The program
    opening       from names to scenes and recordings
    headless      runs without a window
    options       the command line
    suggestions   settings that a scene file recommends
"""

__version__ = "0.1.0"
