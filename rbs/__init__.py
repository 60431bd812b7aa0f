"""The rooms behind the four modules of the coursework: one purpose each.

A newcomer starts at `run_timestep` in RBSFunctions.py. Data flows one way: files → meshes → steps →
pictures and recordings. Rooms import only what stands above them in this list, and nothing imports
`graders`, `tests` or `report`.

Algebra and geometry, below GJK.py
    arrays        indexing of long arrays in few calls
    vectors       vectors by component: tuples of floats, or arrays (3, n)
    hulls         convex hulls, of one shape and of many bodies
    facets        the facets of the Minkowski difference that can be nearest
    patches       contact patches and their centres

What a step may be asked
    messages      errors and lines for the terminal
    settings      the table of settings; their values for a scene; what is refused

Bookkeeping of a step, below RBSFunctions.py: which pairs and constraints, and when
    flight        gravity, free flight, the gyroscopic term
    bodies        the state of meshes in tables; what a contact reads of a body
    poses         what follows from a position and an orientation
    broadphase    boxes that overlap, through uniform grids
    batches       ordered batches of pairs, and what they may have missed
    constraints   the constraints that can be corrected
    schedules     which constraint is visited when
    reports       what a step tells of itself
    islands       bodies that hang together

The solver in which piles rest, behind `contactSolver="soft-step"`
    nearpairs         pairs that can touch soon
    offsets           how a load is held when substeps change their length
    manifolds         up to four contact points a pair
    sleeping          who sleeps, and who wakes
    contactdetection  which manifolds are kept, and which are made anew
    softconstraints   distance constraints, renewed every substep
    impactenergy      how much energy restitution may give back
    solverstate       what a step leaves to the next
    softstep          the solver, with its derivation

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
