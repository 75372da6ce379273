"""Tolerances of surfaces: depth, normals, fusion, meshes."""

# relative; alphas, and all of the expected distance, are float; worst 8.3e-5
SURFACE_MAPS = 2e-4
SURFACE_GRADIENTS = 1e-4  # relative L2: exact formulae along float rays
SURFACE_DISC = 2e-3  # a disc of a thousandth's thickness in place of a plane
MESH_VOXELS = 0.25  # of exact depths; worst 0.235
MESH_VOLUME = 0.02  # relative: a shift of a tenth of a voxel; worst 1.44e-2
MARCHING_CUBES = 2e-6  # voxels: float values, vertices in double here
MESH_FILE = 1e-6  # world units: float32 about zero; 9 digits
MESH_OBJ_FAR = 1e-2  # 9 digits of 5.5e6
MESH_COLORS = 3e-3  # 8 bits, 4 digits
LINEAR_COLORS = 1e-5  # five digits of the expected values
PLANE_DEPTH = 2e-3  # relative: discs of a thousandth's thickness, depths in millimetres
DISTORTION = 1e-4  # relative L2: float sums of squares about the first distance
DISTORTION_FAR = 1e-3  # of distances that differ by a thousandth
SURFACE_EXACT = 1e-12  # a product of doubles
SURFACE_LOSS_DIFFERENCES = 1e-6  # central differences of a smooth loss in double
SURFACE_LOSS_FLOAT = 1e-4  # float maps, sums in double
SURFACE_TERMS = 2e-3  # relative L2: float renders, and the blend's cut-offs, which differences see
CLOUD_UNITS = 5e-7  # float32 of a PLY at 4 units, float depths; worst 2.1e-7
PLANE_POINTS = 1e-2  # discs of a thousandth of a unit, seen at a slant; worst 5.1e-3
DEPTH_LEVELS = 0.51e-3  # half a level of 16 bits
SURFEL = 2e-5  # a thickness of 1e-4 seen at up to 89 degrees, float depths; worst 1.3e-5
SURFEL_GRADIENTS = 1e-4  # relative L2, of the same; worst 4.4e-5
REFINED_MEDIAN = (
    0.006  # of the distance: 0.05 pixels of parallax on pictures of 80 x 80; worst 4.5e-3
)
REFINED_SHARE = 0.3  # of the pixels that windows confirm
REFINED_AGAIN = 0.8  # of the error, which a second round leaves on a rough wall; worst 0.67
REFINED_ROUNDING = 3e-5  # of the distance: grey values of 15 bits, points in float; worst 1.5e-5
# Likewise: lines are sought by iteration, and differences over 1 % of the distance magnify its end.
REFINED_ROLLING = 5e-4  # worst 2.9e-4
