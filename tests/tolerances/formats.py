"""Tolerances of scene files: the largest error of each format, by what it is of."""

# Of tests/python/formats/scene_cases.py: coordinates to 8, harmonics to 0.7, constant ones to 1.7.
# Opacities of a byte: half a step and rounding to float. Rotations of ten bits: half a step in
# three components of a quaternion, and twice that for the derived one.
FORMAT_ERRORS = {
    "PLY": {
        "position": 0.0,
        "log_scale": 0.0,
        "rotation_degrees": 0.0,
        "opacity": 0.0,
        "color": 0.0,
        "harmonics": 0.0,
    },
    # Values between the least and the most of 256 neighbours, half a step of 10 and 8 bits.
    "compressed PLY": {
        "position": 0.5 * 16 / 1023 + 1e-6,
        "log_scale": 0.5 * 7 / 1023 + 1e-6,
        "rotation_degrees": 0.28,
        "opacity": 0.5 / 255 + 1e-6,
        "color": 0.5 * 3.4 / 255 + 1e-6,
        "harmonics": 0.5 * 8 / 256 + 1e-6,
    },
    # Rotations and colours in bytes; harmonics, which it has no place for, are as large as that.
    "splat": {
        "position": 0.0,
        "log_scale": 1e-6,
        "rotation_degrees": 0.9,
        "opacity": 0.5 / 255 + 1e-6,
        "color": 0.5 / 255 / 0.28209 + 1e-6,
        "harmonics": 0.7,
    },
    "SPZ": {
        "position": 0.5 * 2.0**-19 + 1e-6,  # 24 bits for -8 to 8, and float32
        "log_scale": 1 / 32 + 1e-6,
        "rotation_degrees": 0.28,
        "opacity": 0.5 / 255 + 1e-6,
        "color": 0.5 / 255 / 0.15 + 1e-6,
        "harmonics": 1 / 128 + 1e-6,
    },
    # Coordinates in 16 bits of sign(x) log(1 + |x|); rotations in 8 bits; codebooks of 256 entries;
    # random harmonics, which are the hardest, share a palette of one entry for two: worst 0.92
    "SOG": {
        "position": 9 * 0.5 * 4.4 / 65535 + 1e-6,
        "log_scale": 0.03,
        "rotation_degrees": 1.0,
        "opacity": 0.5 / 255 + 1e-6,
        "color": 0.015,
        "harmonics": 1.4,
    },
    # Float32; exp and log of scales, logistic function and logit of opacities
    "glTF": {
        "position": 0.0,
        "log_scale": 2e-6,
        "rotation_degrees": 1e-4,
        "opacity": 1e-6,
        "color": 0.0,
        "harmonics": 0.0,
    },
}
FORMAT_ERRORS["USD"] = FORMAT_ERRORS["glTF"]
PALETTE_OF_BEST = 1.1  # squared error, of k-means on one level; worst 0.98
PLACED = 2e-5  # of coordinates to 40 and harmonics to 1, turned in float32; worst 8e-6
SPZ_DIRECTION = 1.2e-7  # of float32 coordinates, two units; worst 6e-8
GLTF_QUANTISED_TURN = (
    1e-6  # 1 - cosine of half the turn: float32 quaternions of 16 bits; worst 2e-7
)
